"""Creation of requests to the chassis from ROS messages."""

from __future__ import annotations

from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert import Converter


class RequestMaker:
    """Creator of requests that carry the robot's id, if their type has a field for it.

    Attributes:
        robot_id: id of the addressed robot, for gateways that serve several; 0 sends no id.
    """

    def __init__(self, robot_id: int) -> None:
        self.robot_id = robot_id

    def make(self, convert: Converter, ros: Any) -> Message:
        """Return the request for a ROS message.

        Raises:
            BadFieldError: a value must not be sent to the robot.
        """
        return self.address(convert.to_proto(ros))

    def empty(self, proto_class: type[Message]) -> Message:
        """Return a request without content."""
        return self.address(proto_class())

    def address(self, message: Any) -> Message:
        """Set the robot's id in a message that has a field for it, unless it is set; return it."""
        if self.robot_id and "robot_id" in message.DESCRIPTOR.fields_by_name:
            field = message.DESCRIPTOR.fields_by_name["robot_id"]
            # an id that the client has set wins
            if message.WhichOneof(field.containing_oneof.name) is None:
                message.robot_id = self.robot_id
        return message  # type: ignore[no-any-return]
