"""An agent with Nav2's interfaces."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.harness import RunningAgent
from woosh_robot_agent.simulator import SimulatorThread


@pytest.fixture
def agent(simulator: SimulatorThread, start_agent: Callable[..., RunningAgent]) -> RunningAgent:
    """An agent that is connected to the simulator, and has Nav2's interfaces."""
    started = start_agent(ip="127.0.0.1", port=simulator.port, nav2=True, backoff_min=0.1)
    started.wait_connected()
    return started
