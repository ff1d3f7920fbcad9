"""The doctor finds nodes that do not get the last value of a latched topic."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rclpy.qos import DurabilityPolicy, QoSProfile

from tests.harness import Client, wait_until
from woosh_robot_agent.tools.doctor.checks import Result, Status
from woosh_robot_agent.tools.doctor.ros_graph import check_subscribers
from woosh_robot_msgs.msg import OperationState, PoseSpeed


def checked(domain: int, expected: Callable[[Result], bool]) -> Result:
    """Repeat the check until all nodes have discovered each other."""
    results: list[Result] = []

    def check() -> bool:
        results.append(asyncio.run(check_subscribers(domain)))
        return expected(results[-1])

    wait_until(check, "the result of the check")
    return results[-1]


def test_volatile_subscribers_of_latched_topics_are_named(agent, client, domain):
    watcher = Client(domain, name="not_taskable")
    path = client.path("robot/OperationState")
    subscribe = watcher.node.create_subscription
    wrong = subscribe(OperationState, path, lambda message: None, QoSProfile(depth=1))
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    subscribe(PoseSpeed, client.path("robot/PoseSpeed"), lambda message: None, latched)
    found = checked(domain, lambda result: result.status is Status.WARN)
    assert found.text.endswith(f": /not_taskable ({path})")
    assert "TRANSIENT_LOCAL" in found.remedy
    watcher.unsubscribe(wrong)
    checked(domain, lambda result: result.status is Status.OK)
    watcher.close()


def test_domain_without_an_agent_is_skipped(domain):
    result = asyncio.run(check_subscribers(domain))
    assert (result.status, result.text) == (Status.SKIPPED, "no agent runs in this ROS domain")
