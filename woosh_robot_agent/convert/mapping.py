"""Correspondence between the fields of a ROS message and of the protobuf message it mirrors."""

from __future__ import annotations

from typing import Any

from woosh_robot_agent.protos import message_type

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
"""Typecodes of `array.array` by ROS type. ROS takes an array without checking each number."""


def pairs(ros_class: Any, proto_class: Any) -> list[tuple[str, str, Any]]:
    """Return name, ROS type and protobuf field of each field outside of oneofs.

    Raises:
        TypeError: the classes do not mirror each other.
    """
    types = dict(ros_class.get_fields_and_field_types())
    types.pop("has_field", None)
    fields = proto_class.DESCRIPTOR.fields_by_name
    for group in oneofs(proto_class):
        if types.pop(group.name, None) is None:
            raise TypeError(f"{ros_class.__name__} lacks the oneof {group.name}")
    for name in types:
        if name not in fields:
            raise TypeError(f"{proto_class.DESCRIPTOR.full_name} has no field {name}")
    return [(name, ros_type, fields[name]) for name, ros_type in types.items()]


def presence_bits(ros_class: Any, proto_class: Any) -> dict[str, int] | None:
    """Return the bit of each field in `has_field`; None if the class has no `has_field`."""
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


def oneofs(proto_class: Any) -> list[Any]:
    """Return the oneofs of a class, including those made by `optional`."""
    return list(proto_class.DESCRIPTOR.oneofs)


def item_type(ros_type: str) -> str | None:
    """Return `T` of `sequence<T>`; None for other types."""
    if not ros_type.startswith("sequence<"):
        return None
    return ros_type[len("sequence<") : -1]


def message_class(field: Any) -> Any:
    """Return the protobuf class of a message field."""
    return message_type(field.message_type.full_name)
