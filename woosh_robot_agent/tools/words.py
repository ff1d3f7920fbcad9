"""The chassis's enums in words."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from google.protobuf.descriptor import EnumDescriptor

_PREFIXES = ("k", "Ros")
_SUFFIXES = ("Mode",)


def word(enum: Any, number: int) -> str:
    """What a value of a generated enum is called, e.g. `task`; its number if it is unknown."""
    return _word(enum.DESCRIPTOR, number)


@cache
def _word(descriptor: EnumDescriptor, number: int) -> str:
    value = descriptor.values_by_number.get(number)
    if value is None:
        return str(number)
    name = str(value.name)
    if name.endswith("Undefined"):
        return "unknown"
    for prefix in _PREFIXES:
        name = name.removeprefix(prefix)
    for suffix in _SUFFIXES:
        name = name.removesuffix(suffix) or name
    return re.sub(r"(?<=[a-z])(?=[A-Z0-9])", " ", name).lower()
