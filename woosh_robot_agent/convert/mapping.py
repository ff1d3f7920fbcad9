"""What the ROS messages and the protobuf messages that they mirror have in common."""

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
"""Typecodes of Python's arrays, which ROS takes without a look at each number, by ROS type."""


def pairs(ros_class: Any, proto_class: Any) -> list[tuple[str, str, Any]]:
    """Name, ROS type and protobuf field of each field outside of oneofs."""
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
    """Bit of each field in `has_field`; None where a class has no such field."""
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
    """The oneofs, those that `optional` makes included."""
    return list(proto_class.DESCRIPTOR.oneofs)


def item_type(ros_type: str) -> str | None:
    """`T` of `sequence<T>`; None for a type that is no sequence."""
    if not ros_type.startswith("sequence<"):
        return None
    return ros_type[len("sequence<") : -1]


def message_class(field: Any) -> Any:
    """The protobuf class of a field's messages."""
    return message_type(field.message_type.full_name)
