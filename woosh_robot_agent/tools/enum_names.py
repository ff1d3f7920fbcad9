"""Readable names for the values of the chassis's enums."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from google.protobuf.descriptor import EnumDescriptor

_PREFIXES = ("k", "Ros")
_SUFFIXES = ("Mode",)


def enum_name(enum: Any, number: int) -> str:
    """Return the readable name of a value of a generated enum, e.g. `task` for `kTaskMode`.

    An undefined value is called `unknown`. For a value that the enum does not have, the result is
    its number.
    """
    return _enum_name(enum.DESCRIPTOR, number)


@cache
def _enum_name(descriptor: EnumDescriptor, number: int) -> str:
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
