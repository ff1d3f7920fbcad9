"""Protobuf's JSON mapping, compiled once per message class: strict to write, tolerant to read.

`google.protobuf.json_format` is not used because it refuses what chassis of different ages send
(NaN as a number, unknown enum names), and takes 15 times as long.
"""

from __future__ import annotations

import base64
import math
import re
import reprlib
from collections.abc import Callable
from ctypes import c_float
from functools import cache
from typing import Any

from google.protobuf import json_format
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

_WIDE = {
    FieldDescriptor.TYPE_INT64,
    FieldDescriptor.TYPE_UINT64,
    FieldDescriptor.TYPE_SINT64,
    FieldDescriptor.TYPE_FIXED64,
    FieldDescriptor.TYPE_SFIXED64,
}
_FLOATS = (FieldDescriptor.CPPTYPE_FLOAT, FieldDescriptor.CPPTYPE_DOUBLE)
_BAD_VALUE = (ValueError, TypeError, OverflowError)
LONGEST_NUMBER = 400
"""Characters of a number as text; an exact double has up to 325 digits. Reading a text of millions
of digits would take Python seconds or, depending on its settings, hours."""

Setter = Callable[[Any, Any], None]
Field = Any
"""A FieldDescriptor, of which each protobuf implementation has a class of its own."""
MessageClass = Any
"""A type[Message], which the type stubs hold to be unhashable."""


class FieldError(ValueError):
    """A value that does not fit its field.

    Attributes:
        path: the field's path below the message, e.g. `pose.x` or `steps[2].mode`.
    """

    def __init__(self, path: str, reason: str) -> None:
        super().__init__(f"{path}: {reason}" if path else reason)
        self.path = path
        self.reason = reason


def to_json(message: Message, *, defaults: bool) -> dict[str, Any]:
    """The JSON object of a message: lowerCamelCase, enums as numbers, 64-bit integers as strings.

    Args:
        message: any message.
        defaults: write scalars and lists that are at their default, as the chassis does.

    Raises:
        FieldError: a google.protobuf.Any holds a type that is not the chassis's.
    """
    cls: MessageClass = type(message)
    return _encoder(cls, defaults)(message)


def from_json(data: object, message: Message) -> None:
    """Fill `message` from a JSON object.

    Accepts camelCase and snake_case names, enum names and numbers, 64-bit integers as strings
    and numbers, booleans as 0 and 1, NaN and infinities as numbers and strings; skips unknown
    fields and null. In a list, null is NaN among numbers with a fraction, elsewhere the default:
    the places of the others stay.

    Raises:
        FieldError: a value does not fit its field.
    """
    cls: MessageClass = type(message)
    _decoder(cls)(message, data)


# Writing


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
    message_type = field.message_type
    if message_type is None:
        encode = _scalar_encoder(field)
    elif message_type.full_name.startswith("google.protobuf."):
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
    except Exception as error:  # what it raises differs from release to release
        raise FieldError("", f"no JSON for a {value.DESCRIPTOR.full_name}: {error}") from None


def _scalar_encoder(field: Field) -> Callable[[Any], Any]:
    if field.type in _WIDE:
        return str
    if field.type == FieldDescriptor.TYPE_BYTES:
        return lambda value: base64.b64encode(value).decode("ascii")
    if field.type == FieldDescriptor.TYPE_FLOAT:
        return _shortest_float32
    if field.type == FieldDescriptor.TYPE_DOUBLE:
        return lambda value: value if math.isfinite(value) else _name_of_non_finite(value)
    return lambda value: value


def _shortest_float32(value: float) -> float | str:
    if not math.isfinite(value):
        return _name_of_non_finite(value)
    for digits in (7, 8):
        short = float(f"{value:.{digits}g}")
        if c_float(short).value == value:
            return short
    return float(f"{value:.9g}")  # always enough for a float32


def _name_of_non_finite(value: float) -> str:
    if math.isnan(value):
        return "NaN"
    return "Infinity" if value > 0 else "-Infinity"


# Reading


@cache
def _decoder(cls: MessageClass) -> Setter:
    setters: dict[str, tuple[str, Setter]] = {}
    for field in cls.DESCRIPTOR.fields:
        setter = _list_setter(field) if is_repeated(field) else _setter(field)
        for name in json_names(field):
            setters[name] = (field.name, setter)

    def decode(message: Any, data: Any) -> None:
        if not isinstance(data, dict):
            raise FieldError("", f"expected an object, got {_shown(data)}")
        for key, value in data.items():
            known = setters.get(key)
            if known is None or value is None:
                continue
            name, setter = known
            try:
                setter(message, value)
            except FieldError as error:
                raise FieldError(_join(name, error.path), error.reason) from None
            except _BAD_VALUE as error:
                raise FieldError(name, f"{_shown(value)} does not fit ({_why(error)})") from None

    return decode


def _setter(field: Field) -> Setter:
    name = field.name
    if field.message_type is not None:
        fill = _message_filler(field)

        def set_message(message: Any, value: Any) -> None:
            inner = getattr(message, name)
            inner.SetInParent()
            fill(inner, value)

        return set_message
    read = scalar_reader(field)

    def set_scalar(message: Any, value: Any) -> None:
        converted = read(value)
        if converted is not None:
            setattr(message, name, converted)

    return set_scalar


def _list_setter(field: Field) -> Setter:
    name = field.name
    floats = field.cpp_type in _FLOATS
    if field.message_type is not None:
        fill = _message_filler(field)

        def add(items: Any, value: Any) -> None:
            item = items.add()
            if value is not None:
                fill(item, value)
    else:
        read = scalar_reader(field)
        blank = blank_of(field)

        def add(items: Any, value: Any) -> None:
            converted = None if value is None else read(value)
            items.append(blank if converted is None else converted)

    def set_list(message: Any, values: Any) -> None:
        if not isinstance(values, list):
            raise FieldError("", f"expected a list, got {_shown(values)}")
        items = getattr(message, name)
        del items[:]
        if floats:
            try:
                items.extend(values)  # ten times as fast, and scans are long
                return
            except _BAD_VALUE:  # not only numbers
                del items[:]
        for index, value in enumerate(values):
            try:
                add(items, value)
            except FieldError as error:
                raise FieldError(_join(f"[{index}]", error.path), error.reason) from None
            except _BAD_VALUE as error:
                raise FieldError(
                    f"[{index}]", f"{_shown(value)} does not fit ({_why(error)})"
                ) from None

    return set_list


def _message_filler(field: Field) -> Setter:
    if field.message_type.full_name.startswith("google.protobuf."):

        def fill_well_known(message: Any, value: Any) -> None:
            try:
                json_format.ParseDict(value, message, ignore_unknown_fields=True)
            except Exception as error:  # what it raises differs from release to release
                raise FieldError("", f"{_shown(value)} does not fit ({_why(error)})") from None

        return fill_well_known

    def fill(message: Any, value: Any) -> None:
        cls: MessageClass = type(message)
        _decoder(cls)(message, value)

    return fill


def scalar_reader(field: Field) -> Callable[[Any], Any]:
    """What reads a value that is no message, whatever way of writing it has.

    It raises ValueError, TypeError or OverflowError, and gives None for the name of an enum value
    that is newer than this schema.
    """
    if field.enum_type is not None:
        numbers = {value.name: value.number for value in field.enum_type.values}
        return lambda value: _read_enum(value, numbers)
    kind = field.cpp_type
    if kind in _FLOATS:
        return _read_float
    if kind == FieldDescriptor.CPPTYPE_BOOL:
        return _read_bool
    if field.type == FieldDescriptor.TYPE_BYTES:
        return _read_bytes
    if kind == FieldDescriptor.CPPTYPE_STRING:
        return _read_string
    return _read_int


def _read_enum(value: Any, numbers: dict[str, int]) -> int | None:
    """The number of an enum value, or None for a name that is newer than this schema."""
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
    return float(value)  # which takes "NaN" and "-Infinity" too


def _read_bool(value: Any) -> bool:
    if value in (True, "true"):
        return True
    if value in (False, "false"):
        return False
    raise TypeError("not a boolean")


def _read_string(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError("not a string")
    value.encode()  # a lone surrogate is refused here, whatever the protobuf implementation does
    return value


def _read_bytes(value: Any) -> bytes:
    if not isinstance(value, str):
        raise TypeError("not base64 text")
    standard = value.replace("-", "+").replace("_", "/").rstrip("=")
    return base64.b64decode(standard + "=" * (-len(standard) % 4), validate=True)


def blank_of(field: Field) -> Any:
    """What stands in a list for null, and for enum names newer than this schema."""
    return {
        FieldDescriptor.TYPE_FLOAT: math.nan,
        FieldDescriptor.TYPE_DOUBLE: math.nan,
        FieldDescriptor.TYPE_STRING: "",
        FieldDescriptor.TYPE_BYTES: b"",
    }.get(field.type, 0)


def json_names(field: Field) -> list[str]:
    """The names that a field may have in JSON, the one that today's chassis use first."""
    return list(dict.fromkeys((field.json_name, _camel_case(field.name), field.name)))


def is_repeated(field: Field) -> bool:
    """Whether a field is a list."""
    repeated = getattr(field, "is_repeated", None)  # `label` goes away in protobuf 7
    if isinstance(repeated, bool):
        return repeated
    return bool(field.label == FieldDescriptor.LABEL_REPEATED)


def _camel_case(name: str) -> str:
    return re.sub(r"_(\w)", lambda found: found[1].upper(), name)


def _join(outer: str, inner: str) -> str:
    return outer + inner if not inner or inner.startswith("[") else f"{outer}.{inner}"


_BRIEF = reprlib.Repr()  # plain repr() takes seconds for a map, and fails on deep nesting
_BRIEF.maxlevel = 3
_BRIEF.maxstring = _BRIEF.maxother = 40


def _shown(value: object) -> str:
    text = _BRIEF.repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _why(error: Exception) -> str:
    """An error's text, cut: `float()` repeats a value of many MiB whole."""
    text = str(error)
    return text if len(text) <= 100 else text[:97] + "..."
