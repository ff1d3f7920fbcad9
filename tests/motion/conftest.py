"""Fixtures of the motion tests. Every warning is an error, e.g. about unclosed sockets."""

from __future__ import annotations

from pathlib import Path

import pytest

from woosh_robot_agent.motion import gate


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker(pytest.mark.filterwarnings("error"))


@pytest.fixture
def long_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a stop hold for the whole test, even on a slow machine."""
    monkeypatch.setattr(gate, "HOLD", 3600.0)


@pytest.fixture
def long_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the robot count as driving for the whole test, even on a slow machine."""
    monkeypatch.setattr(gate, "DRIVING", 3600.0)
