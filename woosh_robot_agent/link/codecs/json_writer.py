"""Writing protobuf messages as JSON, with an encoder compiled once per message class.

`google.protobuf.json_format` takes about 15 times as long.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from ctypes import c_float
from functools import cache
from typing import Any

from google.protobuf import json_format
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.base64_text import write_base64
from woosh_robot_agent.link.codecs.json_errors import FieldError
from woosh_robot_agent.link.codecs.json_fields import (
    Field,
    MessageClass,
    is_repeated,
    is_well_known,
)

_LARGEST_FLOAT32 = float.fromhex("0x1.fffffep+127")
"""Largest finite value of a float field."""

_INT64 = {
    FieldDescriptor.TYPE_INT64,
    FieldDescriptor.TYPE_UINT64,
    FieldDescriptor.TYPE_SINT64,
    FieldDescriptor.TYPE_FIXED64,
    FieldDescriptor.TYPE_SFIXED64,
}


def to_json(message: Message, *, defaults: bool) -> dict[str, Any]:
    """Return a message as a JSON object.

    Names are in lowerCamelCase, enums are numbers, 64-bit integers are strings.

    Args:
        message: any message.
        defaults: include scalars and lists that have their default value, as the chassis does.

    Raises:
        FieldError: a google.protobuf.Any holds a type that is not one of the chassis.
    """
    cls: MessageClass = type(message)
    return _encoder(cls, defaults)(message)


@cache
def _encoder(cls: MessageClass, defaults: bool) -> Callable[[Message], dict[str, Any]]:
    fields = {
        field.number: (field.json_name, _value_encoder(field, defaults))
        for field in cls.DESCRIPTOR.fields
    }
    blank: dict[str, Any] = {}
    if defaults:
        for field in cls.DESCRIPTOR.fields:
            if is_repeated(field):
                blank[field.json_name] = None
            elif field.message_type is None and field.containing_oneof is None:
                blank[field.json_name] = _scalar_encoder(field)(field.default_value)
    lists = [field.json_name for field in cls.DESCRIPTOR.fields if is_repeated(field)]

    def encode(message: Message) -> dict[str, Any]:
        out = dict(blank)
        for field, value in message.ListFields():
            name, encode_value = fields[field.number]
            out[name] = encode_value(value)
        if defaults:
            for name in lists:
                if out[name] is None:
                    out[name] = []
        return out

    return encode


def _value_encoder(field: Field, defaults: bool) -> Callable[[Any], Any]:
    if field.message_type is None:
        encode = _scalar_encoder(field)
    elif is_well_known(field):
        encode = _encode_well_known
    else:

        def encode(value: Any) -> Any:
            cls: MessageClass = type(value)
            return _encoder(cls, defaults)(value)

    if is_repeated(field):
        return lambda values: [encode(value) for value in values]
    return encode


def _encode_well_known(value: Any) -> Any:
    try:
        return json_format.MessageToDict(value, use_integers_for_enums=True)
    except Exception as error:  # its exceptions differ from release to release
        raise FieldError("", f"no JSON for a {value.DESCRIPTOR.full_name}: {error}") from None


def _scalar_encoder(field: Field) -> Callable[[Any], Any]:
    if field.type in _INT64:
        return str
    if field.type == FieldDescriptor.TYPE_BYTES:
        return write_base64
    if field.type == FieldDescriptor.TYPE_FLOAT:
        return _shortest_float32
    if field.type == FieldDescriptor.TYPE_DOUBLE:
        return lambda value: value if math.isfinite(value) else _non_finite_name(value)
    return lambda value: value


def _shortest_float32(value: float) -> float | str:
    if not math.isfinite(value):
        return _non_finite_name(value)
    if abs(value) == _LARGEST_FLOAT32:  # any shorter number is larger, and refused by protobuf
        return value
    for digits in (7, 8):
        short = float(f"{value:.{digits}g}")
        if c_float(short).value == value:
            return short
    return float(f"{value:.9g}")  # always enough for a float32


def _non_finite_name(value: float) -> str:
    if math.isnan(value):
        return "NaN"
    return "Infinity" if value > 0 else "-Infinity"
