"""Conversion between the ROS messages and the protobuf messages that they mirror.

A converter is compiled once per pair of types: Python source is made from the protobuf descriptor
and the ROS class, by these rules of the mapping, and run once:

- an enum is a ROS message with one field `value` (or a plain integer, in one old message);
- bit i of `has_field` is the presence of the i-th field in declaration order, where that field is
  a message outside of any oneof; from ROS such a field is sent when its bit is set, and to ROS the
  bit is set when the field is present;
- a oneof `x` is a ROS field `x` of a message type of its own, whose `which` counts the members
  from 1 (0: none); `x_choice` repeats it, and is read where `which` is 0, as old clients leave it;
- `bytes` is `uint8[]`; protobuf fields newer than the ROS messages are left out.
"""

from __future__ import annotations

import importlib
import math
from array import array
from collections.abc import Callable
from functools import cache
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from woosh_robot_agent.protos import message_type

_ARRAY_CODES = {
    "boolean": "B",
    "octet": "B",
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float": "f",
    "double": "d",
}
_FLOATS = (FieldDescriptor.CPPTYPE_FLOAT, FieldDescriptor.CPPTYPE_DOUBLE)

Fill = Callable[[Any, Any], None]


class BadFieldError(ValueError):
    """A value in a ROS message that the robot must not get.

    Attributes:
        path: where it stands in the message, e.g. `poses[1].x`.
        reason: what is wrong with it.
    """

    def __init__(self, path: str, reason: str) -> None:
        super().__init__(f"{path} {reason}")
        self.path = path
        self.reason = reason

    def below(self, prefix: str) -> BadFieldError:
        """The same fault, seen from the message that holds this one in its field `prefix`."""
        return BadFieldError(f"{prefix}.{self.path}", self.reason)


class Converter:
    """Converts between one ROS message class and the protobuf message class that it mirrors.

    Raises:
        TypeError: the two do not mirror each other.
    """

    def __init__(self, ros_class: Any, proto_class: Any) -> None:
        self.ros_class = ros_class
        self.proto_class = proto_class
        self._fill_ros = _to_ros(ros_class, proto_class)
        self._fill_proto = _to_proto(ros_class, proto_class)

    def to_ros(self, message: Any) -> Any:
        """A new ROS message with what the protobuf message says."""
        ros = self.ros_class()
        self._fill_ros(ros, message)
        return ros

    def to_proto(self, ros: Any) -> Any:
        """A new protobuf message with what the ROS message says.

        Raises:
            BadFieldError: a number is not finite, or a string was not valid UTF-8.
        """
        message = self.proto_class()
        self._fill_proto(message, ros)
        return message


def converter(ros_class: Any, proto_class: type[Message]) -> Converter:
    """The converter of a pair of types, compiled the first time it is asked for."""
    pair: Any = (ros_class, proto_class)  # the type stubs hold message classes to be unhashable
    return _converter(*pair)


@cache
def _converter(ros_class: Any, proto_class: Any) -> Converter:
    return Converter(ros_class, proto_class)


# Protobuf to ROS: one function fill(r, p) per pair


@cache
def _to_ros(ros_class: Any, proto_class: Any) -> Fill:
    source = _Source("fill(r, p)")
    bits = _presence_bits(ros_class, proto_class)
    if bits is not None:
        source.add("has = 0")
    for name, ros_type, field in _pairs(ros_class, proto_class):
        if bits is not None and name in bits:
            fill = source.bind(_to_ros(_class_of(ros_type), _message_class(field)))
            source.add(f"if p.HasField('{name}'):")
            source.add(f"    has |= {bits[name]}; {fill}(r.{name}, p.{name})")
            if (clear := _clear_presence(_class_of(ros_type))) is not None:
                source.add(f"else: {source.bind(clear)}(r.{name})")
        else:
            _set_ros(source, "r", name, ros_type, field)
    if bits is not None:
        source.add("r.has_field = has")
    for group in _oneofs(proto_class):
        source.add(f"which = p.WhichOneof('{group.name}')")
        inner_class = _class_of(ros_class.get_fields_and_field_types()[group.name])
        types = inner_class.get_fields_and_field_types()
        if (clear := _clear_presence(inner_class)) is not None:
            source.add(f"{source.bind(clear)}(r.{group.name})")
        for number, field in enumerate(group.fields, 1):
            source.add(f"{'el' if number > 1 else ''}if which == '{field.name}':")
            source.add(f"    o = r.{group.name}; o.which = o.{group.name}_choice = {number}")
            _set_ros(source, "o", field.name, types[field.name], field, indent="    ")
    return source.compile()


@cache
def _clear_presence(ros_class: Any) -> Callable[[Any], None] | None:
    """Clears all bits in a new message of a class, which ROS sets; None where there are none."""
    source = _Source("clear(r)")
    for name, ros_type in ros_class.get_fields_and_field_types().items():
        if name == "has_field":
            source.add("r.has_field = 0")
        elif "/" in ros_type and _item_type(ros_type) is None:
            clear = _clear_presence(_class_of(ros_type))
            if clear is not None:
                source.add(f"{source.bind(clear)}(r.{name})")
    return None if source.empty else source.compile()


def _set_ros(
    source: _Source, target: str, name: str, ros_type: str, field: Any, indent: str = ""
) -> None:
    item_type = _item_type(ros_type)
    if item_type is None:
        if field.message_type is not None:
            fill = source.bind(_to_ros(_class_of(ros_type), _message_class(field)))
            source.add(f"{indent}{fill}({target}.{name}, p.{name})")
        elif field.enum_type is not None:
            if "/" in ros_type:
                source.add(f"{indent}{target}.{name}.value = p.{name}")
            else:  # an unsigned field: negative enum values wrap
                source.add(f"{indent}{target}.{name} = p.{name} & 0xFFFFFFFF")
        else:
            source.add(f"{indent}{target}.{name} = p.{name}")
    elif field.message_type is not None:
        item_class = source.bind(_class_of(item_type))
        fill = source.bind(_to_ros(_class_of(item_type), _message_class(field)))
        source.add(f"{indent}items = []")
        source.add(f"{indent}for item in p.{name}:")
        source.add(f"{indent}    made = {item_class}(); {fill}(made, item); items.append(made)")
        source.add(f"{indent}{target}.{name} = items")
    elif field.enum_type is not None:
        item_class = source.bind(_class_of(item_type))
        source.add(f"{indent}{target}.{name} = [{item_class}(value=v) for v in p.{name}]")
    elif item_type == "string":
        source.add(f"{indent}{target}.{name} = list(p.{name})")
    else:
        code = _ARRAY_CODES[item_type]
        source.add(f"{indent}{target}.{name} = {source.bind(array)}('{code}', p.{name})")


# ROS to protobuf: one function fill(p, r) per pair


@cache
def _to_proto(ros_class: Any, proto_class: Any) -> Fill:
    source = _Source("fill(p, r)")
    source.bind_as("BadField", BadFieldError)
    source.bind_as("check_text", _check_text)
    source.bind_as("isfinite", math.isfinite)
    bits = _presence_bits(ros_class, proto_class)
    if bits is not None:
        source.add("has = r.has_field")
    for name, ros_type, field in _pairs(ros_class, proto_class):
        if bits is not None and name in bits:
            source.add(f"if has & {bits[name]}:")
            _set_proto(source, "r", name, ros_type, field, "    ")
        else:
            _set_proto(source, "r", name, ros_type, field)
    for group in _oneofs(proto_class):
        inner_class = _class_of(ros_class.get_fields_and_field_types()[group.name])
        types = inner_class.get_fields_and_field_types()
        source.add(f"o = r.{group.name}; which = o.which or o.{group.name}_choice")
        for number, field in enumerate(group.fields, 1):
            source.add(f"{'el' if number > 1 else ''}if which == {number}:")
            inner = f"{group.name}.{field.name}"
            _set_proto(source, "o", field.name, types[field.name], field, "    ", path=inner)
        source.add("elif which:")
        source.add(f"    raise BadField('{group.name}.which', f'is {{which}}, which is no member')")
    return source.compile()


def _set_proto(
    source: _Source,
    origin: str,
    name: str,
    ros_type: str,
    field: Any,
    indent: str = "",
    path: str = "",
) -> None:
    path = path or name

    def add(line: str) -> None:
        source.add(indent + line)

    item_type = _item_type(ros_type)
    if field.message_type is not None:
        fill = source.bind(_to_proto(_class_of(item_type or ros_type), _message_class(field)))
        if item_type is None:
            add(f"inner = p.{name}; inner.SetInParent()")
            add(f"try: {fill}(inner, {origin}.{name})")
            add(f"except BadField as error: raise error.below('{path}') from None")
        else:
            add(f"for i, item in enumerate({origin}.{name}):")
            add(f"    try: {fill}(p.{name}.add(), item)")
            add(f"    except BadField as error: raise error.below(f'{path}[{{i}}]') from None")
    elif field.enum_type is not None:
        if item_type is not None:
            add(f"p.{name}.extend([item.value for item in {origin}.{name}])")
        elif "/" in ros_type:
            add(f"p.{name} = {origin}.{name}.value")
        else:
            add(f"p.{name} = ({origin}.{name} ^ 0x80000000) - 0x80000000")
    elif field.type == FieldDescriptor.TYPE_BYTES:
        add(f"p.{name} = bytes({origin}.{name})")
    elif item_type is not None:
        if field.cpp_type in _FLOATS:
            add(f"for i, item in enumerate({origin}.{name}):")
            add(f"    if not isfinite(item): raise BadField(f'{path}[{{i}}]', f'is {{item}}')")
        elif item_type == "string":
            add(f"for i, item in enumerate({origin}.{name}): check_text(item, f'{path}[{{i}}]')")
        add(f"p.{name}.extend({origin}.{name})")
    elif field.cpp_type in _FLOATS:
        add(f"value = {origin}.{name}")
        add(f"if not isfinite(value): raise BadField('{path}', f'is {{value}}')")
        add(f"p.{name} = value")
    elif field.cpp_type == FieldDescriptor.CPPTYPE_STRING:
        add(f"value = {origin}.{name}; check_text(value, '{path}'); p.{name} = value")
    else:
        add(f"p.{name} = {origin}.{name}")


def _check_text(text: str, path: str) -> None:
    """Refuse what was not valid UTF-8: rclpy hands it over with U+FFFD in the bad places."""
    if text.isascii():
        return
    if "\ufffd" in text:
        raise BadFieldError(path, "is not valid UTF-8 text")
    try:
        text.encode()
    except UnicodeEncodeError:
        raise BadFieldError(path, "is not valid UTF-8 text") from None


# What the two sides have in common


def _pairs(ros_class: Any, proto_class: Any) -> list[tuple[str, str, Any]]:
    """Name, ROS type and protobuf field of each field outside of oneofs."""
    types = dict(ros_class.get_fields_and_field_types())
    types.pop("has_field", None)
    fields = proto_class.DESCRIPTOR.fields_by_name
    for group in _oneofs(proto_class):
        if types.pop(group.name, None) is None:
            raise TypeError(f"{ros_class.__name__} lacks the oneof {group.name}")
    for name in types:
        if name not in fields:
            raise TypeError(f"{proto_class.DESCRIPTOR.full_name} has no field {name}")
    return [(name, ros_type, fields[name]) for name, ros_type in types.items()]


def _presence_bits(ros_class: Any, proto_class: Any) -> dict[str, int] | None:
    types = ros_class.get_fields_and_field_types()
    if "has_field" not in types:
        return None
    return {
        field.name: 1 << field.index
        for field in proto_class.DESCRIPTOR.fields
        if field.name in types
        and field.message_type is not None
        and _item_type(types[field.name]) is None
    }


def _oneofs(proto_class: Any) -> list[Any]:
    return list(proto_class.DESCRIPTOR.oneofs)


def _item_type(ros_type: str) -> str | None:
    """`T` of `sequence<T>`; None for a type that is no sequence."""
    if not ros_type.startswith("sequence<"):
        return None
    return ros_type[len("sequence<") : -1]


@cache
def _class_of(ros_type: str) -> Any:
    package, name = ros_type.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _message_class(field: Any) -> Any:
    return message_type(field.message_type.full_name)


class _Source:
    """Source of one function that is put together line by line."""

    def __init__(self, head: str) -> None:
        self._function = head.partition("(")[0]
        self._lines = [f"def {head}:"]
        self._names: dict[str, Any] = {}

    @property
    def empty(self) -> bool:
        return len(self._lines) == 1

    def add(self, line: str) -> None:
        self._lines.append("    " + line)

    def bind(self, value: Any) -> str:
        """Make a value known to the function; returns the name under which it is."""
        name = f"_{len(self._names)}"
        self._names[name] = value
        return name

    def bind_as(self, name: str, value: Any) -> None:
        self._names[name] = value

    def compile(self) -> Callable[..., None]:
        if self.empty:
            self.add("pass")
        exec("\n".join(self._lines), self._names)
        function: Callable[..., None] = self._names[self._function]
        return function
