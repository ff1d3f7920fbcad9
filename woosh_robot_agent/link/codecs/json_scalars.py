"""Tolerant readers of single JSON values: numbers, booleans, texts, bytes and enums."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

from google.protobuf.descriptor import FieldDescriptor

from woosh_robot_agent.link.codecs.base64_text import read_base64
from woosh_robot_agent.link.codecs.json_fields import Field

FLOATS = (FieldDescriptor.CPPTYPE_FLOAT, FieldDescriptor.CPPTYPE_DOUBLE)
"""C++ types of the fields that hold a floating-point number."""
LONGEST_NUMBER = 400
"""Longest text that is read as a number, in characters. An exact double has up to 325 digits, and
Python needs seconds, or hours with some settings, to read millions of digits."""


def scalar_reader(field: Field) -> Callable[[Any], Any]:
    """Return the function that converts a JSON value to the value of a scalar field.

    The function accepts every notation of a value. It returns None for the name of an enum value
    that the schema does not have, and raises ValueError, TypeError or OverflowError for a value
    that does not fit.
    """
    if field.enum_type is not None:
        numbers = {value.name: value.number for value in field.enum_type.values}
        return lambda value: _read_enum(value, numbers)
    kind = field.cpp_type
    if kind in FLOATS:
        return _read_float
    if kind == FieldDescriptor.CPPTYPE_BOOL:
        return _read_bool
    if field.type == FieldDescriptor.TYPE_BYTES:
        return _read_bytes
    if kind == FieldDescriptor.CPPTYPE_STRING:
        return _read_string
    return _read_int


def blank_of(field: Field) -> Any:
    """Return the value that replaces null, and the name of an unknown enum value, in a list."""
    return {
        FieldDescriptor.TYPE_FLOAT: math.nan,
        FieldDescriptor.TYPE_DOUBLE: math.nan,
        FieldDescriptor.TYPE_STRING: "",
        FieldDescriptor.TYPE_BYTES: b"",
    }.get(field.type, 0)


def _read_enum(value: Any, numbers: dict[str, int]) -> int | None:
    if isinstance(value, str) and not re.fullmatch(r"-?\d+", value):
        return numbers.get(value)
    return _read_int(value)


def _read_int(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise TypeError("not an integer")
    if isinstance(value, str) and len(value) > LONGEST_NUMBER:
        raise ValueError("too long for a number")
    number = float(value) if isinstance(value, str) and re.search(r"[.eE]", value) else value
    if isinstance(number, float) and not number.is_integer():
        raise ValueError("not an integer")
    return int(number)


def _read_float(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise TypeError("not a number")
    return float(value)  # accepts "NaN" and "-Infinity" as well


def _read_bool(value: Any) -> bool:
    if value in (True, "true"):
        return True
    if value in (False, "false"):
        return False
    raise TypeError("not a boolean")


def _read_string(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError("not a string")
    value.encode()  # refuses half a surrogate pair, which not all protobuf implementations do
    return value


def _read_bytes(value: Any) -> bytes:
    if not isinstance(value, str):
        raise TypeError("not base64 text")
    return read_base64(value)
