"""Properties of protobuf fields that reading and writing JSON share."""

from __future__ import annotations

import re
from typing import Any

from google.protobuf.descriptor import FieldDescriptor

Field = Any
"""A FieldDescriptor. Each protobuf implementation has its own class of them."""
MessageClass = Any
"""A type[Message], which the type stubs declare unhashable."""


def json_names(field: Field) -> list[str]:
    """Return the names that a field may have in JSON, the one that current chassis use first."""
    return list(dict.fromkeys((field.json_name, _camel_case(field.name), field.name)))


def is_repeated(field: Field) -> bool:
    """Return True if a field is a list."""
    repeated = getattr(field, "is_repeated", None)  # `label` goes away in protobuf 7
    if isinstance(repeated, bool):
        return repeated
    return bool(field.label == FieldDescriptor.LABEL_REPEATED)


def is_well_known(field: Field) -> bool:
    """Return True if a field holds one of protobuf's own message types, e.g. google.protobuf.Any.

    These have a JSON form of their own.
    """
    message_type = field.message_type
    return message_type is not None and message_type.full_name.startswith("google.protobuf.")


def _camel_case(name: str) -> str:
    return re.sub(r"_(\w)", lambda found: found[1].upper(), name)
