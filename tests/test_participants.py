"""Where the process of a DDS endpoint runs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from woosh_robot_agent.ros import second_agent
from woosh_robot_agent.ros.second_agent import Place, is_possibly_own, place_of

HOST, OTHER_HOST = b"\x78\xfd", b"\x11\x22"
END = bytes(range(8))


def gid(pid: int, host: bytes = HOST, tail: bytes = b"\x05\xe7") -> list[int]:
    return list(b"\x01\x0f" + host + (pid & 0xFFFF).to_bytes(2, "little") + tail + END)


OWN = gid(os.getpid())


def test_the_own_process_is_recognised():
    assert is_possibly_own(OWN)
    assert not is_possibly_own(gid(os.getpid() + 1))
    assert place_of(OWN, OWN) == (Place.THIS_PROCESS, os.getpid())


def test_a_process_of_this_computer_is_named_if_only_it_can_be_meant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(second_agent, "_PROCESSES", tmp_path)
    other = gid(4321, tail=b"ab")
    (tmp_path / "self").mkdir()
    (tmp_path / "4322").mkdir()
    assert place_of(other, OWN) == (Place.ENDED, 0)
    (tmp_path / "4321").mkdir()
    assert place_of(other, OWN) == (Place.THIS_COMPUTER, 4321)
    (tmp_path / str(4321 + 2**16)).mkdir()
    assert place_of(other, OWN) == (Place.THIS_COMPUTER, 0)


def test_another_computer_is_recognised():
    assert place_of(gid(os.getpid(), OTHER_HOST), OWN) == (Place.OTHER_COMPUTER, 0)


def test_nothing_is_concluded_from_another_form():
    cyclone = [3, *OWN[1:]]
    assert place_of(cyclone, OWN) == (Place.UNKNOWN, 0)
    assert place_of(gid(1), gid(os.getpid() + 1)) == (Place.UNKNOWN, 0)
