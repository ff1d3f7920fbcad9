"""The .msg files of enums."""

from __future__ import annotations

from google.protobuf.descriptor import EnumDescriptor

from woosh_robot_agent.interfaces.definition import Line, message_text
from woosh_robot_agent.interfaces.names import enum_constant
from woosh_robot_agent.interfaces.schema import Schema


def enum_file(enum: EnumDescriptor, schema: Schema) -> str:
    """Return the .msg file of an enum."""
    constants = [
        Line(f"int32 {enum_constant(value.name)}={value.number}", schema.comment(value))
        for value in enum.values
    ]
    return message_text(
        f"{schema.comment(enum)}\nMirrors {enum.full_name}.",
        constants,
        [Line("int32 value", "One of the constants above")],
    )
