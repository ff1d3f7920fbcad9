"""The bit mask `has_field`, which tells which fields of message types are present."""

from __future__ import annotations

from collections.abc import Sequence

from google.protobuf.descriptor import FieldDescriptor

from woosh_robot_agent.interfaces.definition import Line
from woosh_robot_agent.interfaces.names import presence_constant
from woosh_robot_agent.link.codecs.json_fields import is_repeated

_COMMENT = "Presence of the message-typed fields, one bit each; all ones means that all are present"


def presence_mask(fields: Sequence[FieldDescriptor]) -> tuple[list[Line], list[Line]]:
    """Return the constants for the bits and the mask itself; nothing if no field needs a bit."""
    with_bit = [
        field
        for field in fields
        if field.message_type and not field.containing_oneof and not is_repeated(field)
    ]
    if not with_bit:
        return [], []
    size = next(size for size in (8, 16, 32, 64) if len(fields) <= size)
    title = "Bits of `has_field`"
    constants = [
        Line(f"uint{size} {presence_constant(field.name)}={1 << field.index}", "" if i else title)
        for i, field in enumerate(with_bit)
    ]
    return constants, [Line(f"uint{size} has_field {2**size - 1}", _COMMENT)]
