"""The topics: what the chassis pushes, published from the link's thread as it comes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from google.protobuf.message import Message
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from woosh_robot_agent.convert import converter
from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.last_known import parts_of
from woosh_robot_agent.link import Body, ChassisClient
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.protos import full_name, message_type
from woosh_robot_agent.ros_types import class_of


def latched(depth: int) -> QoSProfile:
    """Reliable and kept for late subscribers: state, of which the newest is what counts."""
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


class Topics:
    """All topics of the table: first values from RobotInfo, then each push once, in order."""

    def __init__(self, node: Any, chassis: ChassisClient) -> None:
        self._publish = {}
        chassis.on_snapshot(self._snapshot)
        for topic in TOPICS:
            msg = class_of(topic.msg, "msg")
            proto_class = message_type(topic.push)
            publisher = node.create_publisher(msg, topic.name, latched(topic.depth))
            convert = converter(msg, proto_class)
            self._publish[topic.push] = partial(_publish, publisher, convert.to_ros)
            chassis.subscribe_raw(proto_class, partial(_publish, publisher, convert.read))

    def _snapshot(self, info: RobotInfo) -> None:
        for part in parts_of(info):
            # its status codes are not among the topics: history would pass for news
            if publish := self._publish.get(full_name(part)):
                publish(part)


def _publish(publisher: Any, to_ros: Callable[[Any], Any], said: Message | Body) -> None:
    publisher.publish(to_ros(said))
