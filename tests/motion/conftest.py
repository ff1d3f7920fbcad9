"""Fixtures of the motion tests."""

from __future__ import annotations

import pytest

from woosh_robot_agent.motion import gate


@pytest.fixture
def long_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a stop hold for the whole test, even on a slow machine."""
    monkeypatch.setattr(gate, "HOLD", 3600.0)


@pytest.fixture
def long_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the robot count as driving for the whole test, even on a slow machine."""
    monkeypatch.setattr(gate, "DRIVING", 3600.0)
