"""Fixtures for pytest, and the marks that configure them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing.chassis import running_chassis

if TYPE_CHECKING:
    from woosh_robot_agent.testing.agents import RunningAgent

_MARKS = (
    "woosh_chassis(**options): options of SimulatorConfig for the fixture simulated_chassis",
    "woosh_agent(process=False, namespace='/woosh_robot', **parameters): options and parameters of "
    "the agent for the fixture woosh_agent",
)


def pytest_configure(config: pytest.Config) -> None:
    """Register the marks; called by pytest."""
    for mark in _MARKS:
        config.addinivalue_line("markers", mark)


@pytest.fixture
def ros_domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID for this test only, limited to this machine and set in the environment."""
    from woosh_robot_agent.testing.agents import own_domain  # needs ROS 2

    with own_domain() as domain:
        yield domain


@pytest.fixture
def simulated_chassis(request: pytest.FixtureRequest) -> Iterator[SimulatorThread]:
    """A new simulated chassis on free ports; configured by the mark `woosh_chassis`."""
    with running_chassis(**_mark_options(request, "woosh_chassis")) as chassis:
        yield chassis


@pytest.fixture
def woosh_agent(
    request: pytest.FixtureRequest, simulated_chassis: SimulatorThread
) -> Iterator[RunningAgent]:
    """The real agent, connected to `simulated_chassis`; configured by the mark `woosh_agent`.

    It is in the domain of the fixture `ros_domain` if the test uses that one, otherwise in a new
    domain. The domain is set in the environment, so the nodes of the test are in it, too.
    """
    from woosh_robot_agent.testing.agents import running_agent  # needs ROS 2

    domain = None
    if "ros_domain" in request.fixturenames:
        domain = request.getfixturevalue("ros_domain")
    options = _mark_options(request, "woosh_agent")
    with running_agent(simulated_chassis, domain=domain, **options) as agent:
        yield agent


def _mark_options(request: pytest.FixtureRequest, name: str) -> dict[str, Any]:
    """Return the options of all marks of a name; marks nearer to the test override others."""
    options: dict[str, Any] = {}
    for mark in request.node.iter_markers(name):
        if mark.args:
            raise pytest.UsageError(f"{name} takes keyword arguments only: {mark.args!r}")
        options = {**mark.kwargs, **options}
    return options
