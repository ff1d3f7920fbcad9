"""The fixtures for pytest, and the marks that set them up."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing.agents import RunningAgent, running_agent, running_chassis
from woosh_robot_agent.testing.domains import own_domain

_MARKS = (
    "woosh_chassis(**options): how the fixture simulated_chassis is set up, as SimulatorConfig is",
    "woosh_agent(process=False, namespace='/woosh_robot', **parameters): how the fixture "
    "woosh_agent is set up, parameters of the agent included",
)


def pytest_configure(config: pytest.Config) -> None:
    """Make the marks known to pytest; called by it."""
    for mark in _MARKS:
        config.addinivalue_line("markers", mark)


@pytest.fixture
def ros_domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID of the test's own, on the loopback only; in the environment meanwhile."""
    with own_domain() as domain:
        yield domain


@pytest.fixture
def simulated_chassis(request: pytest.FixtureRequest) -> Iterator[SimulatorThread]:
    """A simulated chassis on free ports, new for each test; see the mark `woosh_chassis`."""
    with running_chassis(**_marked(request, "woosh_chassis")) as chassis:
        yield chassis


@pytest.fixture
def woosh_agent(
    request: pytest.FixtureRequest, simulated_chassis: SimulatorThread
) -> Iterator[RunningAgent]:
    """The real agent under /woosh_robot, connected to the chassis; see the mark `woosh_agent`.

    It is in the domain of `ros_domain` where the test uses that, else in one of its own, and the
    environment says which: the nodes of the test are in it without further ado.
    """
    domain = None
    if "ros_domain" in request.fixturenames:
        domain = request.getfixturevalue("ros_domain")
    with running_agent(
        simulated_chassis, domain=domain, **_marked(request, "woosh_agent")
    ) as agent:
        yield agent


def _marked(request: pytest.FixtureRequest, name: str) -> dict[str, Any]:
    """The options of all marks of that name, those nearest to the test first."""
    options: dict[str, Any] = {}
    for mark in request.node.iter_markers(name):
        if mark.args:
            raise pytest.UsageError(f"{name} takes options by name, not {mark.args!r}")
        options = {**mark.kwargs, **options}
    return options
