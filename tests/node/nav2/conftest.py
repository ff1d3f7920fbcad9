"""Agents with Nav2's interfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing

import pytest

from tests.harness import Robot, RunningAgent
from woosh_robot_agent.simulator import SimulatorThread


@pytest.fixture
def agent(connect: Callable[..., RunningAgent]) -> RunningAgent:
    """An agent that is connected to the simulator, and has Nav2's interfaces."""
    return connect(nav2=True)


@pytest.fixture(scope="module")
def shared_parameters() -> dict[str, bool]:
    return {"nav2": True}


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of a file share, and its new chassis."""
    return shared_robot


@pytest.fixture
def own_robot(agent: RunningAgent, simulator: SimulatorThread) -> Iterator[Robot]:
    """A client of an agent that only this test uses."""
    with closing(Robot(agent, simulator)) as running:
        yield running
