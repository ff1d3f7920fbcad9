"""The chassis's protobuf messages by full name, and the readable names of enum values.

The build of the package compiles `proto/` into the modules of `woosh_robot_agent.pb`.
"""

from __future__ import annotations

import importlib
import os
import re
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

from google.protobuf.descriptor import EnumDescriptor
from google.protobuf.message import Message

from woosh_robot_agent import pb


@cache
def message_types() -> dict[str, type[Message]]:
    """Return all message classes, nested ones included, by protobuf full name.

    Raises:
        OSError: a folder of the modules cannot be read, e.g. for lack of file descriptors.
    """
    found: dict[str, type[Message]] = {}
    root = Path(pb.__path__[0])
    # pkgutil.walk_packages would silently omit a folder that cannot be read
    for folder, _, files in os.walk(root, onerror=_raise):
        for file in files:
            if file.endswith("_pb2.py"):
                parts = Path(folder, file).relative_to(root).with_suffix("").parts
                module = importlib.import_module(".".join((pb.__name__, *parts)))
                for name in module.DESCRIPTOR.message_types_by_name:
                    _collect(getattr(module, name), found)
    return found


def message_type(full_name: str) -> type[Message]:
    """Return the message class with a protobuf full name, e.g. `woosh.robot.PoseSpeed`.

    Raises:
        KeyError: there is no such message.
    """
    return message_types()[full_name]


def full_name(message: Message | type[Message]) -> str:
    """Return the protobuf full name of a message or its class, as used in a frame's `type`."""
    return str(message.DESCRIPTOR.full_name)


_PREFIXES = ("k", "Ros")
_SUFFIXES = ("Mode",)
"""Parts of the names of enum values that are left out of readable names."""


def enum_name(enum: Any, number: int) -> str:
    """Return the readable name of a value of a generated enum, e.g. `task` for `kTaskMode`.

    A value such as `kStateUndefined` is called `unknown`. For a number that the enum does not
    define, the result is the number.
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


def _raise(error: OSError) -> NoReturn:
    raise error


def _collect(cls: Any, found: dict[str, type[Message]]) -> None:
    """Add a message class, and those nested in it, to `found`."""
    found[cls.DESCRIPTOR.full_name] = cls
    for nested in cls.DESCRIPTOR.nested_types:
        _collect(getattr(cls, nested.name), found)
