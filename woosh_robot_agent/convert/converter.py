"""Converters, one per pair of a ROS message class and the protobuf class that it mirrors."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, cached_property
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert.mapping import mirrored_fields
from woosh_robot_agent.convert.to_proto import filler
from woosh_robot_agent.convert.to_ros import JSON, PROTO, Make, maker
from woosh_robot_agent.link.codecs.json_codec import from_json
from woosh_robot_agent.link.frames import Body

_NOT_ACCEPTED = (AttributeError, TypeError, ValueError, OverflowError)
"""Errors of the functions compiled for JSON, for values that they do not accept."""


class Converter:
    """Converter between a ROS message class and the protobuf message class that it mirrors.

    Each direction is compiled on first use: compiling all of them would take a tenth of the
    start-up time. Only the compilation finds nested messages that do not mirror each other.

    Raises:
        TypeError: the classes do not mirror each other.
    """

    def __init__(self, ros_class: Any, proto_class: Any) -> None:
        self.ros_class = ros_class
        self.proto_class = proto_class
        mirrored_fields(ros_class, proto_class)  # raises TypeError

    @cached_property
    def to_ros(self) -> Make:
        """Function that returns a new ROS message with the content of a protobuf message."""
        return maker(self.ros_class, self.proto_class, PROTO)

    @cached_property
    def _from_json(self) -> Make:
        return maker(self.ros_class, self.proto_class, JSON)

    @cached_property
    def _fill_proto(self) -> Callable[[Any, Any], None]:
        return filler(self.ros_class, self.proto_class)

    def from_json(self, value: object) -> Any:
        """Return a new ROS message with the content of a JSON value.

        The same notations are accepted as in frames, see `json_codec.from_json`.

        Raises:
            FieldError: a value does not fit its field.
        """
        try:
            return self._from_json(value)
        except _NOT_ACCEPTED:  # `json_codec.from_json` is slow, but accepts more or names the field
            message = self.proto_class()
            from_json(value, message)
            return self.to_ros(message)

    def read(self, body: Body) -> Any:
        """Return a new ROS message with the content of a frame's body.

        Raises:
            FrameError: the body does not hold such a message.
        """
        return body.read(self.from_json, self.to_ros)

    def to_proto(self, ros: Any) -> Any:
        """Return a new protobuf message with the content of a ROS message.

        Raises:
            BadFieldError: a number is not finite, or a string is not valid UTF-8.
        """
        message = self.proto_class()
        self._fill_proto(message, ros)
        return message


def converter(ros_class: Any, proto_class: type[Message]) -> Converter:
    """Return the converter of a pair of classes, creating it on first use."""
    pair: Any = (ros_class, proto_class)  # the type stubs declare message classes unhashable
    return _converter(*pair)


@cache
def _converter(ros_class: Any, proto_class: Any) -> Converter:
    return Converter(ros_class, proto_class)


class RequestMaker:
    """Creates requests with the robot's id, if their type has a field for it.

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
        """Set the robot's id in a message, if its type has the field and the id is not set yet."""
        if self.robot_id and "robot_id" in message.DESCRIPTOR.fields_by_name:
            field = message.DESCRIPTOR.fields_by_name["robot_id"]
            # an id that the client has set takes precedence; `robot_id` is a member of a oneof
            if message.WhichOneof(field.containing_oneof.name) is None:
                message.robot_id = self.robot_id
        return message  # type: ignore[no-any-return]
