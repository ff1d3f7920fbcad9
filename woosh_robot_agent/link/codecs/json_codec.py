"""Frames as JSON text: decoders and encoders, compiled once per protobuf message class.

`google.protobuf.json_format` takes about 15 times as long, and refuses values that some chassis
send, such as NaN as a number and unknown enum names.
"""

from __future__ import annotations

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

from woosh_robot_agent.link.codecs import json_text
from woosh_robot_agent.link.frames import Envelope, FieldError, FrameError, M, clip_type_name

BAD_VALUE = (ValueError, TypeError, OverflowError)
"""Exceptions that a setter or a converter raises for a value that does not fit."""

_MAX_VALUE = 60
"""Maximum length of a value in an error text, in characters."""
_MAX_REASON = 100
"""Maximum length of the reason in an error text, in characters."""
# plain repr() takes seconds for the bytes of a robot's map, and fails on deep nesting
_REPR = reprlib.Repr()
_REPR.maxlevel = 3
_REPR.maxstring = _REPR.maxother = 40


def bad_value_error(path: str, value: object, error: Exception) -> FieldError:
    """Return the FieldError for a `value` at `path` that a setter refused with `error`."""
    why = _cut(_text(str(error)), _MAX_REASON)  # `float()` repeats a value of many MiB in its text
    return FieldError(path, f"{brief_repr(value)} does not fit ({why})")


def brief_repr(value: object) -> str:
    """Return the start of a value's representation, for an error text."""
    return _cut(_REPR.repr(value), _MAX_VALUE)


def _cut(text: str, limit: int) -> str:
    return text if len(text) <= limit else text[: limit - 3] + "..."


Field = Any
"""A FieldDescriptor. Each protobuf implementation has its own descriptor class."""
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


FLOATS = (FieldDescriptor.CPPTYPE_FLOAT, FieldDescriptor.CPPTYPE_DOUBLE)
"""C++ types of the fields that hold a floating-point number."""
LONGEST_NUMBER = 400
"""Maximum length of a text that is read as a number, in characters. An exact double has up to 325
digits. Python needs seconds to read millions of digits, and hours with some settings."""


def scalar_reader(field: Field) -> Callable[[Any], Any]:
    """Return the function that converts a JSON value to the value of a scalar field.

    The function accepts the notations that `from_json` lists. It returns None for the name of an
    enum value that the schema does not have. It raises ValueError, TypeError or OverflowError for
    a value of another kind, but does not check the range of a number.
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
    """Return the value that replaces null and unknown enum names in a list."""
    return {
        FieldDescriptor.TYPE_FLOAT: math.nan,
        FieldDescriptor.TYPE_DOUBLE: math.nan,
        FieldDescriptor.TYPE_STRING: "",
        FieldDescriptor.TYPE_BYTES: b"",
    }.get(field.type, 0)


def _read_enum(value: Any, numbers: dict[str, int]) -> int | None:
    """Return the number of an enum value, given by name or number; None for an unknown name."""
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
    if value in (True, "true"):  # 1 equals True
        return True
    if value in (False, "false"):
        return False
    raise TypeError("not a boolean")


def _read_string(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError("not a string")
    value.encode()  # refuses lone surrogates, which not all protobuf implementations do
    return value


def _read_bytes(value: Any) -> bytes:
    if not isinstance(value, str):
        raise TypeError("not base64 text")
    return json_text.read_base64(value)


Setter = Callable[[Any, Any], None]
"""Puts a JSON value into a message, or appends it to a list; raises a FieldError or one of
`BAD_VALUE`."""


def from_json(data: object, message: Message) -> None:
    """Fill `message` from a JSON object.

    Accepts camelCase and snake_case names, enum names and numbers, 64-bit integers as strings
    and numbers, booleans also as 0, 1 and strings, NaN and infinities as numbers and strings. Skips
    unknown fields, unknown enum names and null. In a list, these names and null become NaN among
    floating-point numbers and the default elsewhere, so that the other items keep their places.

    Raises:
        FieldError: a value does not fit its field.
    """
    cls: MessageClass = type(message)
    _decoder(cls)(message, data)


@cache
def _decoder(cls: MessageClass) -> Setter:
    """Return the function that fills a message of a class from a JSON object."""
    setters: dict[str, tuple[str, Setter]] = {}
    for field in cls.DESCRIPTOR.fields:
        setter = _list_setter(field) if is_repeated(field) else _setter(field)
        for name in json_names(field):
            setters[name] = (field.name, setter)

    def decode(message: Any, data: Any) -> None:
        if not isinstance(data, dict):
            raise FieldError("", f"expected an object, got {brief_repr(data)}")
        for key, value in data.items():
            known = setters.get(key)
            if known is None or value is None:
                continue
            name, setter = known
            try:
                setter(message, value)
            except FieldError as error:
                raise error.below(name) from None
            except BAD_VALUE as error:
                raise bad_value_error(name, value, error) from None

    return decode


def _setter(field: Field) -> Setter:
    """Return the function that puts a JSON value into a field that is no list."""
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
        if converted is not None:  # None for an unknown name of an enum
            setattr(message, name, converted)

    return set_scalar


def _list_setter(field: Field) -> Setter:
    """Return the function that puts a JSON list into a field."""
    name = field.name
    has_floats = field.cpp_type in FLOATS
    append = _appender(field)

    def set_list(message: Any, values: Any) -> None:
        if not isinstance(values, list):
            raise FieldError("", f"expected a list, got {brief_repr(values)}")
        items = getattr(message, name)
        del items[:]
        if has_floats:
            try:
                items.extend(values)  # ten times as fast as appending each item; scans are long
                return
            except BAD_VALUE:  # some items are not numbers
                del items[:]
        for index, value in enumerate(values):
            try:
                append(items, value)
            except FieldError as error:
                raise error.below(f"[{index}]") from None
            except BAD_VALUE as error:
                raise bad_value_error(f"[{index}]", value, error) from None

    return set_list


def _appender(field: Field) -> Setter:
    """Return the function that appends a JSON value, or a blank one for null, to a field's list."""
    if field.message_type is not None:
        fill = _message_filler(field)

        def append_message(items: Any, value: Any) -> None:
            item = items.add()
            if value is not None:
                fill(item, value)

        return append_message
    read = scalar_reader(field)
    blank = blank_of(field)

    def append_scalar(items: Any, value: Any) -> None:
        converted = None if value is None else read(value)
        items.append(blank if converted is None else converted)

    return append_scalar


def _message_filler(field: Field) -> Setter:
    """Return the function that fills the message of a field from its JSON value."""
    if is_well_known(field):

        def fill_well_known(message: Any, value: Any) -> None:
            try:
                json_format.ParseDict(value, message, ignore_unknown_fields=True)
            except Exception as error:  # its exceptions differ from release to release
                raise bad_value_error("", value, error) from None

        return fill_well_known

    def fill(message: Any, value: Any) -> None:
        cls: MessageClass = type(message)
        _decoder(cls)(message, value)

    return fill


_LARGEST_FLOAT32 = float.fromhex("0x1.fffffep+127")
"""Largest finite value of a float field."""

_INT64 = {
    FieldDescriptor.TYPE_INT64,
    FieldDescriptor.TYPE_UINT64,
    FieldDescriptor.TYPE_SINT64,
    FieldDescriptor.TYPE_FIXED64,
    FieldDescriptor.TYPE_SFIXED64,
}
"""Types of 64-bit integers, which are strings in JSON."""


def to_json(message: Message, *, defaults: bool) -> dict[str, Any]:
    """Return a message as a JSON object.

    Names are in lowerCamelCase, enums are numbers, 64-bit integers are strings.

    Args:
        defaults: True to include scalars and lists that have their default value, as the chassis
            does.

    Raises:
        FieldError: a google.protobuf.Any holds a type that is not one of the chassis.
    """
    cls: MessageClass = type(message)
    return _encoder(cls, defaults)(message)


@cache
def _encoder(cls: MessageClass, defaults: bool) -> Callable[[Message], dict[str, Any]]:
    """Return the function that converts a message of a class to a JSON object.

    With `defaults`, the object also has the fields that have their default value.
    """
    fields = {
        field.number: (field.json_name, _value_encoder(field, defaults))
        for field in cls.DESCRIPTOR.fields
    }
    blank: dict[str, Any] = {}  # default values, in the order of the fields; None for lists
    lists = []
    for field in cls.DESCRIPTOR.fields if defaults else ():
        if is_repeated(field):
            blank[field.json_name] = None  # keeps the place
            lists.append(field.json_name)
        elif field.message_type is None and field.containing_oneof is None:  # has no presence
            blank[field.json_name] = _scalar_encoder(field)(field.default_value)

    def encode(message: Message) -> dict[str, Any]:
        out = dict(blank)
        for name in lists:  # each message needs its own list
            out[name] = []
        for field, value in message.ListFields():
            name, encode_value = fields[field.number]
            out[name] = encode_value(value)
        return out

    return encode


def _value_encoder(field: Field, defaults: bool) -> Callable[[Any], Any]:
    """Return the function that converts the value of a field to JSON."""
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
    """Return the function that converts a number, text or bytes of a field to JSON."""
    if field.type in _INT64:
        return str
    if field.type == FieldDescriptor.TYPE_BYTES:
        return json_text.write_base64
    if field.type == FieldDescriptor.TYPE_FLOAT:
        return _shortest_float32
    if field.type == FieldDescriptor.TYPE_DOUBLE:
        return lambda value: value if math.isfinite(value) else _non_finite_name(value)
    return lambda value: value


def _shortest_float32(value: float) -> float | str:
    """Return the shortest number that is read as the same float32, as JSON."""
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


_MAX_PARTS = 1_000_000
"""Maximum number of objects, lists and names in a frame. An empty list has two bytes on the wire,
and can take a hundred bytes of memory."""
_END_OF_TIME = 253_402_300_800_000
"""Unix time in ms at which the year 10000 begins, which no date can express."""


class JsonCodec:
    """Frames as JSON text.

    Args:
        defaults: True to include fields that have their default value, as the chassis does.
    """

    def __init__(self, *, defaults: bool = False) -> None:
        self._defaults = defaults

    def encode(
        self,
        type_name: str,
        body: Message | None,
        *,
        sn: int = 0,
        ok: bool | None = None,
        msg: str = "",
        timestamp: int | None = None,
    ) -> str:
        frame: dict[str, Any] = {
            "type": type_name,
            "body": {} if body is None else to_json(body, defaults=self._defaults),
        }
        if ok is not None:
            frame["ok"] = ok
            frame["msg"] = msg
        if sn:
            frame["sn"] = sn
        if timestamp is not None:
            frame["timestamp"] = timestamp
        # long base64 texts skip the JSON writer, which would look at each of their characters
        is_long = body is not None and body.ByteSize() >= json_text.LONG_MESSAGE
        texts = json_text.take_from_value(frame) if is_long else []
        text = json_text.write(frame)
        return json_text.put_into_frame(text, texts) if texts else text

    def parse(self, data: str | bytes) -> Any:
        """Return the value of a JSON text.

        Raises:
            FrameError: the text is not JSON, or has too many objects, lists and names.
        """
        try:
            if len(data) <= json_text.LONG_FRAME:  # parsing it hardly blocks the loop
                return json_text.parse(data)
            # long base64 texts are cut out first, because decoding them is faster than parsing them
            data, texts = json_text.take_from_frame(data)
            _check_parts(data)
            value = json_text.parse_in_pieces(data)
        except UnicodeDecodeError as error:
            raise FrameError("utf-8", f"not UTF-8: {error}") from None
        except (ValueError, RecursionError) as error:
            raise FrameError("json", f"not JSON: {error}") from None
        if texts and isinstance(value, dict | list):
            json_text.put_into_value(value, texts)
        return value

    def decode(self, data: str | bytes) -> Envelope:
        frame = self.parse(data)
        if not isinstance(frame, dict):
            raise FrameError("envelope", f"not a JSON object but {type(frame).__name__}")
        ok = frame.get("ok")
        try:
            sn = _integer(frame.get("sn")) or 0
        except BAD_VALUE as error:
            raise FrameError("envelope", f"sn cannot be read: {error}") from None
        timestamp, defect = _time(frame.get("timestamp"))
        type_name = frame.get("type")
        type_name = clip_type_name(_text(type_name)) if isinstance(type_name, str) else ""
        if not type_name and not sn:  # an answer needs only its sn
            raise FrameError("envelope", "no type")
        return Envelope(
            type=type_name,
            body=frame.get("body"),
            ok=None if ok is None else ok in (True, "true"),
            msg=_text(frame["msg"]) if "msg" in frame else "",
            sn=sn,
            timestamp=timestamp,
            defect=defect,
        )

    def body(self, envelope: Envelope, cls: type[M]) -> M:
        message = cls()
        if envelope.body is not None:
            try:
                from_json(envelope.body, message)
            except FieldError as error:
                raise FrameError("body", f"{envelope.type}: {error}") from None
        return message


def _check_parts(text: str | bytes) -> None:
    """Refuse a frame whose parsed value would take too much memory."""
    if len(text) > _MAX_PARTS:
        # each object, list and name has one of these characters
        marks: Any = "{[:" if isinstance(text, str) else (b"{", b"[", b":")
        parts = sum(text.count(mark) for mark in marks)
        if parts > _MAX_PARTS:
            raise FrameError(
                "oversize", f"{parts} objects, lists and names in one frame, more than {_MAX_PARTS}"
            )


def _integer(value: Any) -> int | None:
    """Return a number of the envelope; None if it is left out or null.

    Raises:
        ValueError, TypeError or OverflowError (`BAD_VALUE`): the value is not an integer.
    """
    return value if value is None or type(value) is int else _read_int(value)


def _time(value: object) -> tuple[int | None, str]:
    """Return `timestamp` and `defect` of the Envelope; an invalid time does not spoil the frame."""
    try:
        time = _integer(value)
    except BAD_VALUE as error:
        return None, f"timestamp cannot be read: {error}"
    if time is not None and not 0 <= time < _END_OF_TIME:
        return None, f"timestamp is out of range: {brief_repr(time)}"
    return time, ""


def _text(value: object) -> str:
    """Return a value of the envelope as text; values of other types are tolerated."""
    if not isinstance(value, str):
        return str(value) if isinstance(value, int | float) else ""
    if value.isascii():
        return value
    # JSON can hold lone surrogates; logs and ROS messages cannot
    return value.encode("utf-8", "replace").decode()
