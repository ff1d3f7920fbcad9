"""The .msg files of messages."""

from __future__ import annotations

from google.protobuf.descriptor import Descriptor

from woosh_robot_agent.interfaces.definition import Line, message_text
from woosh_robot_agent.interfaces.field_types import field_type
from woosh_robot_agent.interfaces.names import oneof_message_name
from woosh_robot_agent.interfaces.presence import presence_mask
from woosh_robot_agent.interfaces.schema import Schema

_LEFT_OUT = frozenset({"woosh.robot.ScannerData.offset"})
"""Fields that are newer than their ROS message, whose type hash must not change."""


def message_file(message: Descriptor, schema: Schema) -> str:
    """Return the .msg file of a message. The messages of its oneofs have files of their own."""
    fields = [field for field in message.fields if field.full_name not in _LEFT_OUT]
    lines = [
        Line(f"{field_type(field)} {field.name}", schema.comment(field))
        for field in fields
        if field.containing_oneof is None
    ]
    for oneof in message.oneofs:
        text = f"The oneof `{oneof.name}`: at most one of its members is set"
        lines.append(Line(f"{oneof_message_name(oneof)} {oneof.name}", text))
    constants, mask = presence_mask(fields)
    return message_text(
        f"{schema.comment(message)}\nMirrors {message.full_name}.", constants, lines + mask
    )
