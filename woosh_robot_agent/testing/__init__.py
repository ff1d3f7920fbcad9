"""For the tests of a team's own nodes: a simulated chassis and the real agent before it.

In a `conftest.py`, one line makes the fixtures known:

    from woosh_robot_agent.testing import simulated_chassis, woosh_agent

Other test frameworks use what is underneath:

    with running_chassis() as chassis, running_agent(chassis) as agent:
        ...  # nodes of this process and its children find the agent under /woosh_robot

Importing this needs pytest and rclpy; docs/testing.md shows the whole of it.
"""

from woosh_robot_agent.testing.agents import (
    AgentInProcess,
    AgentProcess,
    RunningAgent,
    running_agent,
    running_chassis,
)
from woosh_robot_agent.testing.domains import own_domain
from woosh_robot_agent.testing.fixtures import (
    pytest_configure,
    ros_domain,
    simulated_chassis,
    woosh_agent,
)
from woosh_robot_agent.testing.spinning import Spinner, spinning
from woosh_robot_agent.testing.waiting import TIMEOUT, wait_until

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
