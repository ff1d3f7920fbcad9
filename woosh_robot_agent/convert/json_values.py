"""Readers of JSON values for ROS fields: fast for usual values, tolerant for others."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from ctypes import c_float
from typing import Any

from google.protobuf.descriptor import FieldDescriptor

from woosh_robot_agent.link.codecs.json_scalars import blank_of, scalar_reader

_MAX_FLOAT32 = 3.4e38
"""Largest value that is used unchanged: a larger one may not fit a float32, and ROS does not
check."""
_INTEGERS = {
    FieldDescriptor.CPPTYPE_INT32: (-(2**31), 2**31 - 1),
    FieldDescriptor.CPPTYPE_UINT32: (0, 2**32 - 1),
    FieldDescriptor.CPPTYPE_INT64: (-(2**63), 2**63 - 1),
    FieldDescriptor.CPPTYPE_UINT64: (0, 2**64 - 1),
    FieldDescriptor.CPPTYPE_ENUM: (-(2**31), 2**31 - 1),
}
"""Smallest and largest value of each integer type."""


def scalar(field: Any) -> tuple[str, Callable[[Any], Any]]:
    """Return a condition for values that need no conversion, and a converter for all others.

    Returns:
        The source of a condition that is true if `v` can be used unchanged, and a function that
        converts all other values. The function raises ValueError, TypeError or OverflowError.
    """
    kind, read = field.cpp_type, scalar_reader(field)
    if field.type == FieldDescriptor.TYPE_BYTES:
        return "False", lambda value: array("B", read(value))
    if kind == FieldDescriptor.CPPTYPE_FLOAT:
        usual = f"type(v) is float and -{_MAX_FLOAT32} <= v <= {_MAX_FLOAT32}"
        return usual, lambda value: c_float(read(value)).value
    if kind == FieldDescriptor.CPPTYPE_DOUBLE:
        return "type(v) is float", read
    if kind == FieldDescriptor.CPPTYPE_BOOL:
        return "type(v) is bool", read
    if kind == FieldDescriptor.CPPTYPE_STRING:
        return "type(v) is str and v.isascii()", read
    least, most = _INTEGERS[kind]

    def read_integer(value: Any) -> int:
        number = read(value)
        if number is None:  # an enum value that is newer than this schema, given by name
            return 0
        if not least <= number <= most:
            raise ValueError("out of range")
        return int(number)

    return f"type(v) is int and {least} <= v <= {most}", read_integer


def list_of(blank: Any) -> Callable[[Any], list[Any]]:
    """Return a function that checks that a value is a list, and replaces null in it by `blank`."""

    def checked(values: Any) -> list[Any]:
        if type(values) is not list:
            raise TypeError("not a list")
        return [blank if value is None else value for value in values] if None in values else values

    return checked


def array_reader(field: Any, code: str) -> Callable[[Any], Any]:
    """Return a function that reads a list of numbers, or bytes, as an array of typecode `code`."""
    if field.type == FieldDescriptor.TYPE_BYTES:
        return scalar(field)[1]
    checked, (_, read) = list_of(blank_of(field)), scalar(field)

    def read_each(values: Any) -> Any:
        return array(code, [read(value) for value in checked(values)])

    def read_floats(values: Any) -> Any:
        try:
            if type(values) is list:
                return array(code, values)  # the usual case: only numbers
        except (TypeError, OverflowError):
            pass  # null, or a number as text: read them one by one
        return read_each(values)

    return read_floats if code in "fd" else read_each
