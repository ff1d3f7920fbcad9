"""An agent that the tests of a file share, because each start of one costs much CPU time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest

from tests.harness import Robot, RunningAgent, own_domain
from woosh_robot_agent.ros.standard import diagnostics, states
from woosh_robot_agent.ros.standard import map as map_part
from woosh_robot_agent.simulator import SimulatorThread


@pytest.fixture
def frequent(monkeypatch: pytest.MonkeyPatch) -> None:
    """The agent publishes and checks often what it does once or twice a second."""
    monkeypatch.setattr(diagnostics, "_RATE", 20.0)
    monkeypatch.setattr(map_part, "_CHECK_RATE", 20.0)
    monkeypatch.setattr(states, "_BATTERY_RATE", 20.0)
    monkeypatch.setattr(states, "_FOOTPRINT_RATE", 20.0)


@pytest.fixture(scope="module")
def shared_parameters() -> dict[str, Any]:
    """Parameters of the agent that the tests of a file share; a file may replace them."""
    return {}


@pytest.fixture(scope="module")
def _shared(shared_parameters: dict[str, Any]) -> Iterator[Robot]:
    address = {"ip": "127.0.0.1", "port": 1, "backoff_min": 0.1}
    with (
        own_domain() as domain,
        closing(RunningAgent(domain, **{**address, **shared_parameters})) as agent,
        closing(Robot(agent, None)) as robot,  # type: ignore[arg-type]
    ):
        yield robot


@pytest.fixture
def shared_robot(_shared: Robot, simulator: SimulatorThread) -> Iterator[Robot]:
    """A client of the agent of the file, which is connected to a new chassis.

    Not for tests that end the agent, change its parameters, call its service `stop`, or count its
    connections.
    """
    _shared.use(simulator)
    yield _shared
    _shared.forget()
