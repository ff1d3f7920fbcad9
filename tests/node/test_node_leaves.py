"""A closed agent and a closed test client leave nothing behind in the graph of their process."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator

import pytest

from tests.harness import Client, RunningAgent, wait_until
from woosh_robot_msgs.srv import PoseSpeed
from woosh_ros_msgs.action import StepControl


@pytest.fixture
def no_collection() -> Iterator[None]:
    """No collection of reference cycles, which may come much later than the end of an agent."""
    gc.disable()
    yield
    gc.enable()


@pytest.mark.usefixtures("no_collection")
def test_agent_and_client_leave_the_graph_when_they_are_closed(
    domain: int,
    connect: Callable[..., RunningAgent],
) -> None:
    agent = connect(publish_tf=True)
    user = Client(domain)
    user.call(PoseSpeed, "robot/PoseSpeed")
    goal = user.send_goal(StepControl, "ros/StepControl", StepControl.Goal())
    goal.result()
    observer = Client(domain, name="observer")

    def names() -> list[str]:
        return sorted(observer.node.get_node_names())

    wait_until(lambda: names() == ["agent", "client", "observer"], "all nodes in the graph")
    user.close()
    wait_until(lambda: names() == ["agent", "observer"], "the end of the client")
    agent.close()
    wait_until(lambda: names() == ["observer"], "the end of the agent")
    observer.close()
