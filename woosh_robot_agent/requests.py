"""Requests to the chassis, as they are made of what a ROS client asks."""

from __future__ import annotations

from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert import Converter


class RequestMaker:
    """Makes requests, with the robot's id in those that have room for it.

    Attributes:
        robot_id: id of the robot that is meant, for links that serve several; 0 is not sent.
    """

    def __init__(self, robot_id: int) -> None:
        self.robot_id = robot_id

    def make(self, convert: Converter, ros: Any) -> Message:
        """The protobuf message of a ROS message.

        Raises:
            BadFieldError: the robot must not get a value of it.
        """
        return self.address(convert.to_proto(ros))

    def empty(self, proto_class: type[Message]) -> Message:
        """A request that only names its type."""
        return self.address(proto_class())

    def address(self, message: Any) -> Message:
        """The message itself, with the robot's id in it if it has room for that and none yet."""
        if self.robot_id and "robot_id" in message.DESCRIPTOR.fields_by_name:
            field = message.DESCRIPTOR.fields_by_name["robot_id"]
            # what the client says itself goes first
            if message.WhichOneof(field.containing_oneof.name) is None:
                message.robot_id = self.robot_id
        return message  # type: ignore[no-any-return]
