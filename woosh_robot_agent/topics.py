"""The topics: pushes of the chassis, published directly from the link thread."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert import converter
from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.last_known import parts_of
from woosh_robot_agent.latched import LatchedPublisher, LatchedPublishers
from woosh_robot_agent.link import Body, ChassisClient
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.protos import full_name, message_type
from woosh_robot_agent.ros_types import class_of


class Topics:
    """Publishers of all topics in the table.

    Each topic gets its first value from RobotInfo, and then each push once, in order.

    Args:
        latched: creates the publishers.
        chassis: the link; used in its event loop only.
    """

    def __init__(self, latched: LatchedPublishers, chassis: ChassisClient) -> None:
        self._publish = {}
        chassis.on_snapshot(self._snapshot)
        for topic in TOPICS:
            msg = class_of(topic.msg, "msg")
            proto_class = message_type(topic.push)
            publisher = latched.create(msg, topic.name, topic.depth)
            convert = converter(msg, proto_class)
            self._publish[topic.push] = partial(_publish, publisher, convert.to_ros)
            chassis.subscribe_raw(proto_class, partial(_publish, publisher, convert.read))

    def _snapshot(self, info: RobotInfo) -> None:
        for part in parts_of(info):
            # StatusCodes has no topic: old codes would look like new ones on robot/StatusCode
            if publish := self._publish.get(full_name(part)):
                publish(part)


def _publish(
    publisher: LatchedPublisher, to_ros: Callable[[Any], Any], value: Message | Body
) -> None:
    publisher.publish(to_ros(value))
