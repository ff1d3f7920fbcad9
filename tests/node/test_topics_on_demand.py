"""Topics with large pushes: the chassis is asked for them only while somebody listens."""

from __future__ import annotations

import pytest

from tests.harness import Client, Collector, Robot, wait_until
from tests.node.test_topics import subscribed
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.pb.robot.robot_pack_pb2 import BuildMapData
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import BuildMapData as BuildMapDataMsg

ON_DEMAND = [topic for topic in TOPICS if topic.on_demand]
NAME, PUSH = "robot/BuildMapData", "woosh.robot.BuildMapData"


def echo(client: Client, simulator: SimulatorThread) -> Collector:
    """Subscribe to the topic, and wait until the agent has subscribed at the chassis."""
    collector = client.echo(BuildMapDataMsg, NAME)
    wait_until(lambda: PUSH in subscribed(simulator), "the subscription at the chassis")
    return collector


def stop_listening(client: Client) -> None:
    for subscription in list(client.node.subscriptions):
        if subscription.topic_name == client.path(NAME):
            client.unsubscribe(subscription)


@pytest.mark.parametrize("topic", ON_DEMAND, ids=lambda topic: topic.name)
def test_the_chassis_is_asked_while_there_is_a_subscriber(robot: Robot, topic: object) -> None:
    robot.chassis.wait_received("woosh.Subscription")
    assert "woosh.robot.PoseSpeed" in subscribed(robot.chassis)
    assert topic.push not in subscribed(robot.chassis)  # type: ignore[attr-defined]
    ros_class = class_of(topic.msg, "msg")  # type: ignore[attr-defined]
    collector = robot.echo(ros_class, topic.name)  # type: ignore[attr-defined]
    wait_until(lambda: topic.push in subscribed(robot.chassis))  # type: ignore[attr-defined]
    robot.chassis.push(message_type(topic.push)())  # type: ignore[attr-defined]
    collector.wait_count(1)


def test_the_chassis_is_no_longer_asked_after_the_last_subscriber(robot: Robot) -> None:
    first = echo(robot, robot.chassis)
    second = robot.echo(BuildMapDataMsg, NAME)
    wait_until(lambda: robot.node.count_subscribers(robot.path(NAME)) == 2)
    robot.chassis.push(BuildMapData(width=1))
    for collector in (first, second):
        collector.wait(lambda m: m.width == 1)
    stop_listening(robot)
    wait_until(lambda: PUSH not in subscribed(robot.chassis), "the end of the subscription")
    late = echo(robot, robot.chassis)
    assert late.wait_count(1)[0].width == 1, "the last value is kept"


def test_it_is_asked_again_after_a_lost_link_and_by_another_robot(robot: Robot) -> None:
    collector = echo(robot, robot.chassis)
    robot.chassis.drop()
    robot.agent.wait_connected(2)
    last = [each for each in robot.chassis.received if each.type == "woosh.Subscription"][-1]
    assert PUSH in last.message.topics
    robot.chassis.push(BuildMapData(width=2))
    collector.wait(lambda m: m.width == 2)
