"""The .msg files of oneofs."""

from __future__ import annotations

from google.protobuf.descriptor import OneofDescriptor

from woosh_robot_agent.interfaces.definition import Line, message_text
from woosh_robot_agent.interfaces.field_types import field_type
from woosh_robot_agent.interfaces.names import member_constant
from woosh_robot_agent.interfaces.schema import Schema


def oneof_file(oneof: OneofDescriptor, schema: Schema) -> str:
    """Return the .msg file of a oneof."""
    message = oneof.containing_type.full_name
    constants = [Line(f"int8 {member_constant(oneof)}=0", "Values of `which`")]
    constants += [
        Line(f"int8 {member_constant(oneof, field.name)}={number}")
        for number, field in enumerate(oneof.fields, start=1)
    ]
    fields = [
        Line(f"{field_type(field)} {field.name}", schema.comment(field)) for field in oneof.fields
    ]
    choice = "Same as `which`, for older clients; used if `which` is 0"
    return message_text(
        f"Which member of the oneof `{oneof.name}` of {message} is set, and its value.",
        constants,
        [
            *fields,
            Line(f"int8 {oneof.name}_choice", choice),
            Line("int8 which", "Constant of the member that is set"),
        ],
    )
