"""Conversion to ROS messages, from JSON values and from protobuf messages.

A message is created without its constructor, which would take longer than the rest of the
conversion: it would create all nested messages, which are replaced anyway. The fields are set
directly in the slots behind the properties. The constructor and the properties are used if ROS
checks fields (`ROS_PYTHON_CHECK_FIELDS=1`), or if a class has unexpected slots.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable
from ctypes import c_float
from functools import cache, partial
from typing import Any

from google.protobuf.descriptor import FieldDescriptor

from woosh_robot_agent.convert.mapping import (
    ARRAY_CODES,
    FunctionSource,
    class_of,
    extra_slots,
    item_type,
    message_class,
    mirrored_fields,
    presence_bits,
)
from woosh_robot_agent.link.codecs.json_codec import (
    blank_of,
    is_repeated,
    json_names,
    scalar_reader,
)

_MAX_FLOAT32 = 3.4e38
"""Largest number that is used unchanged for a float32. A larger one may not fit, and ROS does not
check it."""
_INTEGERS = {
    FieldDescriptor.CPPTYPE_INT32: (-(2**31), 2**31 - 1),
    FieldDescriptor.CPPTYPE_UINT32: (0, 2**32 - 1),
    FieldDescriptor.CPPTYPE_INT64: (-(2**63), 2**63 - 1),
    FieldDescriptor.CPPTYPE_UINT64: (0, 2**64 - 1),
    FieldDescriptor.CPPTYPE_ENUM: (-(2**31), 2**31 - 1),
}
"""Smallest and largest value of each integer type."""


def scalar_conversion(field: Any) -> tuple[str, Callable[[Any], Any]]:
    """Return how a JSON value `v` becomes the value of a field of a ROS message.

    Returns:
        The source of a condition that is true if `v` can be used unchanged, and a function that
        converts all other values. The function raises ValueError, TypeError or OverflowError.
    """
    kind, read = field.cpp_type, scalar_reader(field)
    if field.type == FieldDescriptor.TYPE_BYTES:
        return "False", lambda value: array("B", read(value))
    if kind == FieldDescriptor.CPPTYPE_FLOAT:
        fits = f"type(v) is float and -{_MAX_FLOAT32} <= v <= {_MAX_FLOAT32}"
        return fits, lambda value: c_float(read(value)).value
    if kind == FieldDescriptor.CPPTYPE_DOUBLE:
        return "type(v) is float", read
    if kind == FieldDescriptor.CPPTYPE_BOOL:
        return "type(v) is bool", read
    if kind == FieldDescriptor.CPPTYPE_STRING:
        # other texts may have lone surrogates, which `read` refuses
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


def list_reader(blank: Any) -> Callable[[Any], list[Any]]:
    """Return a function that reads a JSON list, and replaces each null by `blank`.

    The function raises a TypeError if the value is no list.
    """

    def read_list(values: Any) -> list[Any]:
        if type(values) is not list:
            raise TypeError("not a list")
        return [blank if value is None else value for value in values] if None in values else values

    return read_list


def array_reader(field: Any, code: str) -> Callable[[Any], Any]:
    """Return a function that reads a list of numbers, or bytes, as an array of typecode `code`."""
    if field.type == FieldDescriptor.TYPE_BYTES:
        return scalar_conversion(field)[1]
    read_list, (_, read) = list_reader(blank_of(field)), scalar_conversion(field)

    def read_each(values: Any) -> Any:
        return array(code, [read(value) for value in read_list(values)])

    def read_floats(values: Any) -> Any:
        try:
            if type(values) is list:
                return array(code, values)  # the usual case: only numbers
        except (TypeError, OverflowError):
            pass  # null, or a number as text, e.g. "Infinity" in a scan
        numbers = [value if type(value) is float else read(value) for value in read_list(values)]
        return array(code, numbers)

    return read_floats if code in "fd" else read_each


def new_message(ros_class: Any, **fields: Any) -> Any:
    """Return a new message; `fields` must give the values of all fields of its class."""
    extra = extra_slots(ros_class)
    if extra is None:  # the slots must not be set directly
        return ros_class(**fields)
    message = object.__new__(ros_class)
    for name, value in extra.items():
        setattr(message, name, value)
    for name, value in fields.items():
        setattr(message, f"_{name}", value)
    return message


class MessageSource:
    """Writes source code that creates a message and sets its fields.

    Args:
        source: the function to which the code is added.
        variable: variable of the function that holds the message.
    """

    def __init__(self, source: FunctionSource, variable: str, ros_class: Any) -> None:
        self.source = source
        self._variable = variable
        extra = extra_slots(ros_class)
        self._prefix = "" if extra is None else "_"
        """Prefix of a field's name: `_` to set its slot, none to set its property."""
        bound = source.bind(ros_class)
        if extra is None:
            source.add(f"{variable} = {bound}()")
            return
        source.add(f"{variable} = {source.bind(object.__new__)}({bound})")
        for name, value in extra.items():
            source.add(f"{variable}.{name} = {value!r}")

    def set(self, name: str, expression: str) -> None:
        """Add source that sets a field."""
        self.source.add(f"{self._variable}.{self._prefix}{name} = {expression}")


Make = Callable[[Any], Any]
"""Function that returns a new ROS message."""


class Origin(ABC):
    """Form of the data that ROS messages are made from: protobuf or JSON.

    Its methods write source code that reads values from the argument `d` of the function.
    """

    def begin(self, source: FunctionSource) -> None:  # noqa: B027 - empty by default
        """Write source for the beginning of the function."""

    @abstractmethod
    def fetch(self, source: FunctionSource, field: Any) -> bool:
        """Write source that assigns a field to `v`; return True if `v` can be None (absent)."""

    @abstractmethod
    def scalar(self, source: FunctionSource, field: Any) -> str:
        """Return the expression for the number, text or enum value in `v`."""

    @abstractmethod
    def scalars(self, source: FunctionSource, field: Any) -> str:
        """Return the expression for an iterable of numbers, texts or enum values in `v`."""

    @abstractmethod
    def numbers(self, source: FunctionSource, field: Any, code: str) -> str:
        """Return the expression for an array of typecode `code` with the list or bytes in `v`."""

    @abstractmethod
    def messages(self, source: FunctionSource) -> str:
        """Return the expression for the iterable of messages in `v`."""


class _Proto(Origin):
    """A protobuf message."""

    def fetch(self, source: FunctionSource, field: Any) -> bool:
        has_presence = field.containing_oneof is not None or field.message_type is not None
        optional = has_presence and not is_repeated(field)
        presence = f" if d.HasField('{field.name}') else None" if optional else ""
        source.add(f"v = d.{field.name}{presence}")
        return optional

    def scalar(self, source: FunctionSource, field: Any) -> str:
        return "v"

    def scalars(self, source: FunctionSource, field: Any) -> str:
        return "v[:]"

    def numbers(self, source: FunctionSource, field: Any, code: str) -> str:
        return f"{source.bind(array)}('{code}', v[:])"

    def messages(self, source: FunctionSource) -> str:
        return "v"


class _Json(Origin):
    """A JSON object."""

    def begin(self, source: FunctionSource) -> None:
        source.add("get = d.get")

    def fetch(self, source: FunctionSource, field: Any) -> bool:
        first, *others = json_names(field)
        source.add(f"v = get({first!r})")
        for name in others:
            source.add(f"if v is None: v = get({name!r})")
        return True  # any key can be missing

    def scalar(self, source: FunctionSource, field: Any) -> str:
        fits, read = scalar_conversion(field)
        return f"v if {fits} else {source.bind(read)}(v)"

    def scalars(self, source: FunctionSource, field: Any) -> str:
        read_list = source.bind(list_reader(blank_of(field)))
        return f"[{self.scalar(source, field)} for v in {read_list}(v)]"

    def numbers(self, source: FunctionSource, field: Any, code: str) -> str:
        return f"{source.bind(array_reader(field, code))}(v)"

    def messages(self, source: FunctionSource) -> str:
        return f"{source.bind(list_reader({}))}(v)"


PROTO = _Proto()
JSON = _Json()


@cache
def maker(ros_class: Any, proto_class: Any, origin: Origin) -> Make:
    """Return a function that creates a ROS message from data of the form `origin`.

    Raises:
        TypeError: the classes do not mirror each other.
    """
    source = FunctionSource("make(d)")
    origin.begin(source)
    made = MessageSource(source, "r", ros_class)
    bits = presence_bits(ros_class, proto_class)
    if bits is not None:
        source.add("has = 0")
    for name, ros_type, field in mirrored_fields(ros_class, proto_class):
        optional = origin.fetch(source, field)
        if bits is not None and name in bits:
            source.add(f"if v is not None: has |= {bits[name]}")
        _set(made, name, ros_type, field, origin, optional=optional)
    if bits is not None:
        made.set("has_field", "has")
    for group in proto_class.DESCRIPTOR.oneofs:
        inner_class = class_of(ros_class.get_fields_and_field_types()[group.name])
        types = inner_class.get_fields_and_field_types()
        inner = MessageSource(source, "o", inner_class)
        source.add("which = 0")
        for number, field in enumerate(group.fields, 1):
            origin.fetch(source, field)
            source.add("if v is not None:")
            source.add(f"    if which: raise ValueError('several members of {group.name}')")
            source.add(f"    which = {number}")
            _set(inner, field.name, types[field.name], field, origin, optional=True)
        inner.set("which", "which")
        inner.set(f"{group.name}_choice", "which")
        made.set(group.name, "o")
    source.add("return r")
    return source.compile()


def _set(
    made: MessageSource, name: str, ros_type: str, field: Any, origin: Origin, *, optional: bool
) -> None:
    """Write source that sets the field `name` from `v`.

    With `optional`, `v` may be None. Then the field gets its blank value: 0, or an empty text, list
    or message.
    """
    source, items = made.source, item_type(ros_type)
    if items is not None:
        blank, value = _list_expressions(source, items, field, origin)
    elif field.message_type is not None:
        ros_class, proto_class = class_of(ros_type), message_class(field)
        # a blank message is made like one from an empty JSON object
        blank = f"{source.bind(partial(maker(ros_class, proto_class, JSON), {}))}()"
        value = f"{source.bind(maker(ros_class, proto_class, origin))}(v)"
    else:
        blank, value = _BLANKS.get(ros_type, "0"), origin.scalar(source, field)
        if field.enum_type is not None and "/" not in ros_type:  # unsigned: negative values wrap
            value = f"({value}) & 0xFFFFFFFF"
    if optional:
        value = f"{blank} if v is None else {value}"
    is_enum_message = field.enum_type is not None and items is None and "/" in ros_type
    if is_enum_message:
        source.add(f"v = {value}")
        enum = MessageSource(source, "e", class_of(ros_type))
        enum.set("value", "v")
        value = "e"
    made.set(name, value)


_BLANKS = {"boolean": "False", "string": "''", "float": "0.0", "double": "0.0"}
"""Sources of the blank values by ROS type, if not 0."""


def _list_expressions(
    source: FunctionSource, items: str, field: Any, origin: Origin
) -> tuple[str, str]:
    """Return the source of an empty list, and of a list of the ROS type `items` made from `v`."""
    if field.message_type is not None:
        make = source.bind(maker(class_of(items), message_class(field), origin))
        return "[]", f"[{make}(item) for item in {origin.messages(source)}]"
    if field.enum_type is not None:
        enum = source.bind(_enum_maker(class_of(items)))
        return "[]", f"[{enum}(item) for item in {origin.scalars(source, field)}]"
    if items == "string":
        return "[]", f"[*{origin.scalars(source, field)}]"
    code = ARRAY_CODES[items]
    return f"{source.bind(array)}('{code}')", origin.numbers(source, field, code)


@cache
def _enum_maker(ros_class: Any) -> Make:
    """Return a function that creates an enum message from its number."""
    source = FunctionSource("make(v)")
    made = MessageSource(source, "e", ros_class)
    made.set("value", "v")
    source.add("return e")
    return source.compile()
