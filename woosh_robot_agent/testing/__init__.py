"""Fixtures to test your own nodes with a simulated chassis and the real agent.

To use them with pytest, import them in `conftest.py`:

    from woosh_robot_agent.testing import simulated_chassis, woosh_agent

With other test frameworks, use the context managers:

    with running_chassis() as chassis, running_agent(chassis) as agent:
        ...  # nodes of this process and its children find the agent in /woosh_robot

This package needs pytest and rclpy. docs/testing.md has an example and describes everything.
"""

from woosh_robot_agent.testing.agents import (
    TIMEOUT,
    AgentInProcess,
    AgentProcess,
    RunningAgent,
    Spinner,
    own_domain,
    running_agent,
    running_chassis,
    spinning,
    wait_until,
)
from woosh_robot_agent.testing.fixtures import (
    pytest_configure,
    ros_domain,
    simulated_chassis,
    woosh_agent,
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
