"""Several sources that command velocities at the same time."""

from __future__ import annotations

import logging
import time
from types import SimpleNamespace

import pytest

from tests.link.link_peer import aio
from tests.watch.rig import READY, Rig
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.robot import who_drives
from woosh_robot_agent.robot.who_drives import WINDOW, Interleaving

FORWARD, ZERO = Twist(linear=0.2), Twist()


@pytest.fixture
def long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let velocities count as simultaneous for the whole test, even on a slow machine."""
    monkeypatch.setattr(who_drives, "OVERLAP", 3600.0)


class Clock:
    """A clock that the test sets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = time.monotonic()
        monkeypatch.setattr(who_drives, "time", SimpleNamespace(monotonic=lambda: self.now))


@pytest.mark.usefixtures("long")
@pytest.mark.parametrize("second", [FORWARD, ZERO])
@aio
async def test_two_sources_are_named(second: Twist) -> None:
    async with Rig(READY).running() as rig:
        await rig.send(FORWARD, "robot/Twist")
        assert rig.watch.velocities.simultaneous == ()
        await rig.send(second, "cmd_vel")
        assert rig.watch.velocities.simultaneous == ("cmd_vel", "robot/Twist")


@pytest.mark.usefixtures("long")
@aio
async def test_they_are_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    async with Rig(READY).running() as rig:
        for _ in range(3):
            await rig.send(FORWARD, "robot/Twist")
            await rig.send(FORWARD, "cmd_vel")
    texts = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    assert [text.partition(" command")[0] for text in texts] == ["cmd_vel and robot/Twist"]


@pytest.mark.usefixtures("long")
@aio
async def test_one_source_is_fine():
    async with Rig(READY).running() as rig:
        for message in (FORWARD, FORWARD, ZERO, FORWARD):
            await rig.send(message, "cmd_vel")
        assert rig.watch.velocities.simultaneous == ()


@pytest.mark.usefixtures("long")
@aio
async def test_a_source_that_has_stopped_may_be_followed_by_another():
    async with Rig(READY).running() as rig:
        await rig.send(FORWARD, "cmd_vel")
        await rig.send(ZERO, "cmd_vel")
        await rig.send(FORWARD, "robot/Twist")
        assert rig.watch.velocities.simultaneous == ()


@pytest.mark.usefixtures("long")
@aio
async def test_refused_velocities_do_not_count():
    rig = Rig(READY)
    async with rig.running():
        rig.refusal = "State not allow to twist"
        await rig.send(FORWARD, "cmd_vel")
        rig.refusal = ""
        await rig.send(FORWARD, "robot/Twist")
        assert rig.watch.velocities.simultaneous == ()


def test_a_source_that_falls_silent_may_be_followed_by_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock(monkeypatch)

    @aio
    async def run() -> None:
        async with Rig(READY).running() as rig:
            await rig.send(FORWARD, "cmd_vel")
            clock.now += who_drives.OVERLAP
            await rig.send(FORWARD, "robot/Twist")
            assert rig.watch.velocities.simultaneous == ()
            clock.now += who_drives.OVERLAP / 2
            await rig.send(FORWARD, "cmd_vel")
            assert rig.watch.velocities.simultaneous
            clock.now += who_drives.SHOWN
            assert rig.watch.velocities.simultaneous == ()

    run()


class TestInterleaving:
    def noticed(self, *numbers: int | None, step: float = 0.1) -> bool:
        interleaving = Interleaving()
        noticed = [interleaving.notice(n, 9.0 + i * step) for i, n in enumerate(numbers)]
        return any(noticed)

    def test_two_publishers_are_noticed(self):
        assert self.noticed(100, 5, 101, 6, 102)
        assert self.noticed(1, 1, 2, 2)
        assert self.noticed(7, 100, 8, 101, 9, 10)

    def test_one_publisher_is_not(self):
        assert not self.noticed(1, 2, 3, 7, 20)

    def test_a_restarted_publisher_is_not(self):
        assert not self.noticed(100, 101, 1, 2, 3)
        assert not self.noticed(100, 1, 2, 1, 2, step=WINDOW)

    def test_messages_without_a_number_say_nothing(self):
        assert not self.noticed(0, 0, 0, None, None, 2**64 - 1, 2**64 - 1)
