"""Conversion of the model's dataclasses to data that JSON can hold, and back."""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from typing import Any, TypeVar

T = TypeVar("T")


def to_plain(value: Any) -> Any:
    """Return a value as dictionaries, lists, strings, numbers, bools and None."""
    if is_dataclass(value):
        return {field.name: to_plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple | list):
        return [to_plain(each) for each in value]
    if isinstance(value, Mapping):
        return {key: to_plain(each) for key, each in value.items()}
    return value


def from_plain(cls: type[T], data: Any) -> T:
    """Return the dataclass instance for data from `to_plain`.

    Unknown fields are ignored, and missing ones take their defaults.

    Raises:
        ValueError: the data does not fit the class.
    """
    return _value(cls, data)  # type: ignore[no-any-return]


def _value(kind: Any, data: Any) -> Any:
    if kind is Any:
        return data
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (types.UnionType, typing.Union):
        inner = next(each for each in arguments if each is not types.NoneType)
        return None if data is None else _value(inner, data)
    if origin is tuple:
        return tuple(_value(arguments[0], each) for each in _checked(list, data))
    if origin is Mapping:
        return {key: _value(arguments[1], each) for key, each in _checked(dict, data).items()}
    if is_dataclass(kind):
        return _dataclass(kind, _checked(dict, data))
    if issubclass(kind, Enum):
        return kind(data)
    if kind is float and type(data) is int:
        return float(data)
    return _checked(kind, data)


def _dataclass(kind: Any, data: dict[str, Any]) -> Any:
    hints = typing.get_type_hints(kind)
    values = {}
    for field in fields(kind):
        if field.name in data:
            values[field.name] = _value(hints[field.name], data[field.name])
        elif field.default is MISSING and field.default_factory is MISSING:
            raise ValueError(f"{kind.__name__} has no {field.name}")
    return kind(**values)


def _checked(kind: Any, data: Any) -> Any:
    if type(data) is not kind:
        raise ValueError(f"a {kind.__name__} was expected, not {type(data).__name__}")
    return data
