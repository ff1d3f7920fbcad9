"""Fixtures to test your own nodes with a simulated chassis and the real agent.

To use them with pytest, import them in `conftest.py`:

    from woosh_robot_agent.testing import simulated_chassis, woosh_agent

With other test frameworks, use the context managers:

    with running_chassis() as chassis, running_agent(chassis) as agent:
        ...  # nodes of this process and its children find the agent in /woosh_robot

This package needs pytest. Helpers that run an agent or nodes also need ROS 2, and are imported on
first use; the simulated chassis works without ROS 2. docs/testing.md describes everything, with an
example.
"""

from typing import TYPE_CHECKING

from woosh_robot_agent.testing.chassis import TIMEOUT, running_chassis, wait_until
from woosh_robot_agent.testing.fixtures import (
    pytest_configure,
    ros_domain,
    simulated_chassis,
    woosh_agent,
)

if TYPE_CHECKING:
    from woosh_robot_agent.testing.agents import (
        AgentInProcess,
        AgentProcess,
        RunningAgent,
        Spinner,
        own_domain,
        running_agent,
        spinning,
    )

__all__ = [
    "TIMEOUT",
    "AgentInProcess",
    "AgentProcess",
    "RunningAgent",
    "Spinner",
    "own_domain",
    "pytest_configure",
    "ros_domain",
    "running_agent",
    "running_chassis",
    "simulated_chassis",
    "spinning",
    "wait_until",
    "woosh_agent",
]


def __getattr__(name: str) -> object:
    """Import a helper that needs ROS 2 on its first use."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from woosh_robot_agent.testing import agents

    return getattr(agents, name)
