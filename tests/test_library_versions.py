"""Libraries that are too old are named, with the remedy."""

from __future__ import annotations

import google.protobuf
import pytest

from woosh_robot_agent import agent, library_versions


@pytest.mark.parametrize(
    ("websockets", "protobuf", "named"),
    [
        ("9.1", "3.12.4", "websockets 9.1 and protobuf 3.12.4"),
        ("9.1", "6.30.0", "websockets 9.1"),
        ("10.4", "3.20.3", "protobuf 3.20.3"),
    ],
)
def test_the_agent_names_old_libraries_and_ends(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    websockets: str,
    protobuf: str,
    named: str,
) -> None:
    monkeypatch.setattr(library_versions, "websockets_version", websockets)
    monkeypatch.setattr(google.protobuf, "__version__", protobuf)
    assert agent._run([], signals=None) == 2  # type: ignore[arg-type]
    assert capsys.readouterr().err == (
        f"agent: too old: {named}; run: python3 -m pip install 'websockets>=10.4' "
        "'protobuf>=3.21'\n"
    )


@pytest.mark.parametrize(("websockets", "protobuf"), [("10.4", "3.21.12"), ("17.4", "4.21.12")])
def test_supported_libraries_are_accepted(
    monkeypatch: pytest.MonkeyPatch, websockets: str, protobuf: str
) -> None:
    monkeypatch.setattr(library_versions, "websockets_version", websockets)
    monkeypatch.setattr(google.protobuf, "__version__", protobuf)
    assert library_versions.outdated_libraries() == ""
