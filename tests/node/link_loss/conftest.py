"""An agent whose goals survive the loss of the link for a while, on a slow machine too."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.harness import RunningAgent
from tests.node.goals import set_timing
from woosh_robot_agent.simulator import SimulatorThread


@pytest.fixture
def timeouts() -> dict[str, Any]:
    """Timeouts long enough for a slow machine to find the link and the goal again."""
    return {"goal_link_timeout": 10.0, "poll_timeout": 1000}


@pytest.fixture
def agent(
    simulator: SimulatorThread,
    start_agent: Callable[..., RunningAgent],
    timeouts: dict[str, Any],
) -> RunningAgent:
    """The agent, connected, with short back-offs."""
    started = start_agent(
        ip="127.0.0.1",
        port=simulator.port,
        backoff_min=0.1,
        backoff_max=0.1,
        **timeouts,
    )
    started.wait_connected()
    return started


@pytest.fixture(autouse=True)
def frequent_polls(monkeypatch: pytest.MonkeyPatch) -> None:
    set_timing(monkeypatch, poll_period=0.6)
