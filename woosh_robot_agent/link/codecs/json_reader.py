"""Reading JSON into protobuf messages, with a decoder compiled once per message class.

`google.protobuf.json_format` refuses values that some chassis send, such as NaN as a number and
unknown enum names, and takes about 15 times as long.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from google.protobuf import json_format
from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.json_errors import BAD_VALUE, FieldError, brief_repr, misfit
from woosh_robot_agent.link.codecs.json_fields import (
    Field,
    MessageClass,
    is_repeated,
    is_well_known,
    json_names,
)
from woosh_robot_agent.link.codecs.json_scalars import FLOATS, blank_of, scalar_reader

Setter = Callable[[Any, Any], None]
"""Puts a JSON value into a message, or appends it to a list."""


def from_json(data: object, message: Message) -> None:
    """Fill `message` from a JSON object.

    Accepts camelCase and snake_case names, enum names and numbers, 64-bit integers as strings
    and numbers, booleans as 0 and 1, NaN and infinities as numbers and strings. Skips unknown
    fields and null. In a list, null becomes NaN among floating-point numbers and the default
    elsewhere, so that the other items keep their places.

    Raises:
        FieldError: a value does not fit its field.
    """
    cls: MessageClass = type(message)
    _decoder(cls)(message, data)


@cache
def _decoder(cls: MessageClass) -> Setter:
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
                raise misfit(name, value, error) from None

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
    floats = field.cpp_type in FLOATS
    append = _appender(field)

    def set_list(message: Any, values: Any) -> None:
        if not isinstance(values, list):
            raise FieldError("", f"expected a list, got {brief_repr(values)}")
        items = getattr(message, name)
        del items[:]
        if floats:
            try:
                items.extend(values)  # ten times as fast, and scans are long
                return
            except BAD_VALUE:  # some items are not numbers
                del items[:]
        for index, value in enumerate(values):
            try:
                append(items, value)
            except FieldError as error:
                raise error.below(f"[{index}]") from None
            except BAD_VALUE as error:
                raise misfit(f"[{index}]", value, error) from None

    return set_list


def _appender(field: Field) -> Setter:
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
    if is_well_known(field):

        def fill_well_known(message: Any, value: Any) -> None:
            try:
                json_format.ParseDict(value, message, ignore_unknown_fields=True)
            except Exception as error:  # its exceptions differ from release to release
                raise misfit("", value, error) from None

        return fill_well_known

    def fill(message: Any, value: Any) -> None:
        cls: MessageClass = type(message)
        _decoder(cls)(message, value)

    return fill
