"""The ROS types of fields."""

from __future__ import annotations

from google.protobuf.descriptor import FieldDescriptor

from woosh_robot_agent.interfaces.names import message_name
from woosh_robot_agent.link.codecs.json_fields import is_repeated

_SCALARS = {
    FieldDescriptor.TYPE_DOUBLE: "float64",
    FieldDescriptor.TYPE_FLOAT: "float32",
    FieldDescriptor.TYPE_INT64: "int64",
    FieldDescriptor.TYPE_SINT64: "int64",
    FieldDescriptor.TYPE_SFIXED64: "int64",
    FieldDescriptor.TYPE_UINT64: "uint64",
    FieldDescriptor.TYPE_FIXED64: "uint64",
    FieldDescriptor.TYPE_INT32: "int32",
    FieldDescriptor.TYPE_SINT32: "int32",
    FieldDescriptor.TYPE_SFIXED32: "int32",
    FieldDescriptor.TYPE_UINT32: "uint32",
    FieldDescriptor.TYPE_FIXED32: "uint32",
    FieldDescriptor.TYPE_BOOL: "bool",
    FieldDescriptor.TYPE_STRING: "string",
    FieldDescriptor.TYPE_BYTES: "uint8[]",
}
_NUMBERS = {"woosh.task.TaskSetBase.rtype": "uint32"}
"""Enum fields that are plain numbers: their enum is in a package that depends on the field's."""


def field_type(field: FieldDescriptor) -> str:
    """Return the ROS type of a field, e.g. `woosh_common_msgs/Point[]`."""
    if field.full_name in _NUMBERS:
        name = _NUMBERS[field.full_name]
    elif structure := field.message_type or field.enum_type:
        name = message_name(structure)
    else:
        name = _SCALARS[field.type]
    return f"{name}[]" if is_repeated(field) else name
