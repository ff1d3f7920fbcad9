"""Correspondence of ROS and protobuf types, and generation of the functions that convert them."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from woosh_robot_agent.link.frames import FieldError
from woosh_robot_agent.link.protos import message_type


class BadFieldError(FieldError):
    """A ROS message holds a value that must not be sent to the robot."""


class FunctionSource:
    """Source code of one generated function, built line by line.

    Args:
        head: name and arguments of the function, e.g. `fill(p, r)`.
        names: values that are available to the function, by name.
    """

    def __init__(self, head: str, **names: Any) -> None:
        self._function = head.partition("(")[0]
        self._lines = [f"def {head}:"]
        self._names = names

    def add(self, line: str) -> None:
        """Append a line to the function's body."""
        self._lines.append("    " + line)

    def bind(self, value: Any) -> str:
        """Make a value available to the function; return its generated name."""
        name = f"_{len(self._names)}"
        self._names[name] = value
        return name

    def compile(self) -> Callable[..., Any]:
        """Compile and return the function."""
        if len(self._lines) == 1:
            self.add("pass")
        exec("\n".join(self._lines), self._names)
        function: Callable[..., Any] = self._names[self._function]
        return function


@cache
def class_of(name: str, kind: str = "msg") -> Any:
    """Return the class of a ROS type.

    Args:
        name: package and type, e.g. `woosh_robot_msgs/Twist`.
        kind: `msg`, `srv` or `action`.
    """
    package, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), short)


@cache
def extra_slots(ros_class: Any) -> Mapping[str, Any] | None:
    """Return the slots of a message that are no fields, with their initial values by name.

    The classes of Jazzy and Kilted have the slot `_check_fields`, and those of Humble have none.
    Return None if the slots must not be set directly, because ROS checks fields
    (`ROS_PYTHON_CHECK_FIELDS=1`) or the class has unexpected slots.
    """
    fields = {f"_{name}" for name in ros_class.get_fields_and_field_types()}
    extra = set(ros_class.__slots__) - fields
    if not extra:
        return {} if fields == set(ros_class.__slots__) else None
    if extra != {"_check_fields"} or ros_class()._check_fields:
        return None
    return {"_check_fields": False}


ARRAY_CODES = {
    "boolean": "B",
    "octet": "B",
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float": "f",
    "double": "d",
}
"""Typecodes of `array.array` by ROS type. ROS accepts an array without checking each number."""


def mirrored_fields(ros_class: Any, proto_class: Any) -> list[tuple[str, str, Any]]:
    """Return name, ROS type and protobuf descriptor of each ROS field, except for oneofs.

    Raises:
        TypeError: the classes do not mirror each other.
    """
    types = dict(ros_class.get_fields_and_field_types())
    types.pop("has_field", None)
    fields = proto_class.DESCRIPTOR.fields_by_name
    for group in proto_class.DESCRIPTOR.oneofs:  # an `optional` field has one, too
        if types.pop(group.name, None) is None:
            raise TypeError(f"{ros_class.__name__} lacks the oneof {group.name}")
    for name in types:
        if name not in fields:
            raise TypeError(f"{proto_class.DESCRIPTOR.full_name} has no field {name}")
    return [(name, ros_type, fields[name]) for name, ros_type in types.items()]


def presence_bits(ros_class: Any, proto_class: Any) -> dict[str, int] | None:
    """Return the bits in `has_field` by field name; None if the class has no `has_field`."""
    types = ros_class.get_fields_and_field_types()
    if "has_field" not in types:
        return None
    return {
        field.name: 1 << field.index
        for field in proto_class.DESCRIPTOR.fields
        if field.name in types
        and field.message_type is not None
        and item_type(types[field.name]) is None
    }


def item_type(ros_type: str) -> str | None:
    """Return `T` of `sequence<T>`; None for other types."""
    if not ros_type.startswith("sequence<"):
        return None
    return ros_type[len("sequence<") : -1]


def message_class(field: Any) -> Any:
    """Return the protobuf class of a message field."""
    return message_type(field.message_type.full_name)
