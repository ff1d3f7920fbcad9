"""The compiled protobuf messages of the chassis, by full name.

The modules below `woosh_robot_agent.pb` are made from `proto/` by the package's build.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from typing import Any

from google.protobuf.message import Message

try:
    from woosh_robot_agent import pb
except ImportError as error:  # a checkout in which nothing was built yet
    raise ImportError(
        "the protobuf modules are not compiled: run scripts/setup or python3 setup.py build_proto"
    ) from error


@cache
def message_types() -> dict[str, type[Message]]:
    """Every message class of the chassis, nested ones included, by protobuf full name."""
    found: dict[str, type[Message]] = {}
    for module_info in pkgutil.walk_packages(pb.__path__, pb.__name__ + "."):
        if module_info.ispkg:
            continue
        module = importlib.import_module(module_info.name)
        for name in module.DESCRIPTOR.message_types_by_name:
            _collect(getattr(module, name), found)
    return found


def message_type(full_name: str) -> type[Message]:
    """The message class called `full_name`, e.g. `woosh.robot.PoseSpeed`.

    Raises:
        KeyError: no message has that name.
    """
    return message_types()[full_name]


def full_name(message: Message | type[Message]) -> str:
    """The protobuf full name of a message or its class, as it stands in a frame's `type`."""
    return str(message.DESCRIPTOR.full_name)


def _collect(cls: Any, found: dict[str, type[Message]]) -> None:
    found[cls.DESCRIPTOR.full_name] = cls
    for nested in cls.DESCRIPTOR.nested_types:
        _collect(getattr(cls, nested.name), found)
