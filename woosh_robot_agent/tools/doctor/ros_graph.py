"""The check of the ROS graph: subscribers that do not get the last value of a topic."""

from __future__ import annotations

import asyncio
import os
from typing import Any

from woosh_robot_agent.program import import_problem
from woosh_robot_agent.tools.doctor.checks import Result, Status

_DISCOVERY_TIME = 2.0
"""Time in which the other nodes are discovered, in seconds."""


async def check_subscribers(domain: int | None = None) -> Result:
    """Look for subscribers with volatile durability of topics that agents latch.

    The agent publishes a state when it changes. A subscriber that starts later gets the last value
    only with the durability TRANSIENT_LOCAL, and a robot that stands still changes nothing.

    Args:
        domain: ROS_DOMAIN_ID; by default from the environment.
    """
    try:
        from woosh_robot_agent.tools.ros_node import NodeThread
    except ImportError as error:
        return Result(Status.SKIPPED, import_problem(error) or str(error))
    try:
        thread = NodeThread(f"doctor_{os.getpid()}", "", domain=domain)
    except Exception as error:  # its type is rclpy's
        return Result(Status.SKIPPED, f"no ROS node can be started: {error}")
    try:
        await asyncio.sleep(_DISCOVERY_TIME)
        found, agents = _volatile_subscribers(thread.node)
    finally:
        thread.close()
    if not agents:
        return Result(Status.SKIPPED, "no agent runs in this ROS domain")
    if not found:
        return Result(Status.OK, "all subscribers of latched topics get the last value")
    return Result(
        Status.WARN,
        f"these nodes get nothing until the robot's state changes: {', '.join(found)}",
        "let them subscribe with the durability TRANSIENT_LOCAL, see docs/migration.md",
    )


def _volatile_subscribers(node: Any) -> tuple[list[str], set[str]]:
    """Return the volatile subscribers of the agents' latched topics, and the agents' node names."""
    topics = dict(node.get_topic_names_and_types())
    topics.pop("/rosout", None)  # its subscribers want no old messages
    publishers = {
        topic: {
            _full_name(each)
            for each in node.get_publishers_info_by_topic(topic)
            if each.qos_profile.durability.name == "TRANSIENT_LOCAL"
        }
        for topic in topics
    }
    agents: set[str] = set()  # the nodes that latch topics with types of the chassis
    for topic, types in topics.items():
        if any(each.startswith("woosh_") for each in types):
            agents |= publishers[topic]
    found = [
        f"{_full_name(each)} ({topic})"
        for topic in sorted(topics)
        if publishers[topic] & agents
        for each in node.get_subscriptions_info_by_topic(topic)
        if each.qos_profile.durability.name == "VOLATILE"
    ]
    return found, agents


def _full_name(endpoint: Any) -> str:
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
