"""The topics in `endpoints.TOPICS`, with the pushes of the chassis, and the topic AgentInfo.

All are published directly from the link thread.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from woosh_robot_agent.convert import Converter, converter
from woosh_robot_agent.convert.cdr import serialize
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import AGENT_INFO, TOPICS, Topic
from woosh_robot_agent.link import Body, ChassisClient
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.robot.last_known import parts_of
from woosh_robot_agent.ros.bridge import LinkThread
from woosh_robot_agent.ros.qos import latched
from woosh_robot_agent.ros.subscribers import Subscribers, create_publisher, publish_readiness


class Topics:
    """Publishers of the topics.

    Each topic gets its first value from RobotInfo, then each push once, in order. A topic that is
    published on demand only gets pushes.
    """

    def __init__(self, node: Any, thread: LinkThread, chassis: ChassisClient) -> None:
        self._first: dict[str, tuple[Any, Converter]] = {}
        """Publisher and converter of each topic that gets its first value from RobotInfo, by the
        protobuf full name of its pushes."""
        # RobotInfo is converted by the second function, and published by the first one
        chassis.on_snapshot(self._publish_parts, self._serialized_parts)
        for topic in TOPICS:
            if topic.on_demand:
                _publish_on_demand(topic, node, thread, chassis)
                continue
            msg = class_of(topic.msg, "msg")
            proto_class = message_type(topic.push)
            publisher = create_publisher(node, msg, topic.name, latched(topic.depth))
            convert = converter(msg, proto_class)
            self._first[topic.push] = publisher, convert
            chassis.subscribe_raw(proto_class, publisher.publish, partial(_serialized, convert))
        info = class_of(AGENT_INFO.msg, "msg")
        publisher = create_publisher(node, info, AGENT_INFO.name, latched(1))
        publish_readiness(chassis, publisher, lambda online: info(online=online))

    def _serialized_parts(self, info: RobotInfo) -> list[tuple[Any, bytes]]:
        """Return the publisher and the first message of each topic whose value `info` has."""
        messages = []
        for part in parts_of(info):
            # General, TaskHistory and StatusCodes have no topic. StatusCodes, the recent codes, are
            # not published on robot/StatusCode: subscribers would take old codes for new ones.
            if first := self._first.get(full_name(part)):
                publisher, convert = first
                messages.append((publisher, serialize(convert.to_ros(part))))
        return messages

    def _publish_parts(self, messages: list[tuple[Any, bytes]]) -> None:
        for publisher, message in messages:
            publisher.publish(message)


def _serialized(convert: Converter, body: Body) -> bytes:
    return serialize(convert.read(body))


def _publish_on_demand(topic: Topic, node: Any, thread: LinkThread, chassis: ChassisClient) -> None:
    """Publish a topic that is subscribed to at the chassis only while it has subscribers."""
    msg, proto_class = class_of(topic.msg, "msg"), message_type(topic.push)
    prepare = partial(_serialized, converter(msg, proto_class))
    subscribers = Subscribers(node, thread)
    publisher = subscribers.publisher(msg, topic.name, latched(topic.depth))

    async def run() -> None:
        while True:
            await subscribers.wait(present=True)
            unsubscribe = chassis.subscribe_raw(proto_class, publisher.publish, prepare)
            await subscribers.wait(present=False)
            unsubscribe()

    thread.spawn(run)
