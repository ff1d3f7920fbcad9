"""Converters: one per pair of a ROS message class and the protobuf class that it mirrors."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, cached_property
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert import to_proto, to_ros
from woosh_robot_agent.convert.mapping import pairs
from woosh_robot_agent.link.body import Body
from woosh_robot_agent.link.codecs.json_reader import from_json

_UNUSUAL = (AttributeError, TypeError, ValueError, OverflowError)
"""What compiled functions raise for JSON that is not as it should be."""


class Converter:
    """Converts between one ROS message class and the protobuf message class that it mirrors.

    Each way is compiled when it is gone for the first time: to do all of them at the start would
    be a tenth of it. Messages inside that do not mirror each other are found only then.

    Raises:
        TypeError: the two do not mirror each other.
    """

    def __init__(self, ros_class: Any, proto_class: Any) -> None:
        self.ros_class = ros_class
        self.proto_class = proto_class
        pairs(ros_class, proto_class)  # looks whether there are any

    @cached_property
    def _from_proto(self) -> to_ros.Make:
        return to_ros.maker(self.ros_class, self.proto_class, to_ros.PROTO)

    @cached_property
    def _from_json(self) -> to_ros.Make:
        return to_ros.maker(self.ros_class, self.proto_class, to_ros.JSON)

    @cached_property
    def _fill_proto(self) -> Callable[[Any, Any], None]:
        return to_proto.filler(self.ros_class, self.proto_class)

    def to_ros(self, message: Any) -> Any:
        """A new ROS message with what the protobuf message says."""
        return self._from_proto(message)

    def from_json(self, value: object) -> Any:
        """A new ROS message with what a JSON value says; it is read as tolerantly as by the link.

        Raises:
            FieldError: a value does not fit its field.
        """
        try:
            return self._from_json(value)
        except _UNUSUAL:  # the long way finds the field, or a sense in it
            message = self.proto_class()
            from_json(value, message)
            return self.to_ros(message)

    def read(self, body: Body) -> Any:
        """A new ROS message with what a frame's body says.

        Raises:
            FrameError: it is no such message.
        """
        return body.read(self.from_json, self.to_ros)

    def to_proto(self, ros: Any) -> Any:
        """A new protobuf message with what the ROS message says.

        Raises:
            BadFieldError: a number is not finite, or a string was not valid UTF-8.
        """
        message = self.proto_class()
        self._fill_proto(message, ros)
        return message


def converter(ros_class: Any, proto_class: type[Message]) -> Converter:
    """The converter of a pair of types, the same each time."""
    pair: Any = (ros_class, proto_class)  # the type stubs hold message classes to be unhashable
    return _converter(*pair)


@cache
def _converter(ros_class: Any, proto_class: Any) -> Converter:
    return Converter(ros_class, proto_class)
