"""A minimal replacement of ROS's `launch`, which is not on PyPI. It can load our launch files."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any


class Part:
    """Stand-in for any object that a launch file creates; stores its arguments."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        self.arguments = arguments
        self.named = named

    def __getattr__(self, name: str) -> Any:
        try:
            return self.__dict__["named"][name]
        except KeyError:
            raise AttributeError(name) from None


class Context(dict[str, Any]):
    """A launch context: the launch configurations by name.

    Attributes:
        argv: launch arguments of the command line, e.g. `port:=5490`.
        is_shutdown: True once the launch ends.
    """

    def __init__(self) -> None:
        super().__init__()
        self.argv: list[str] = []
        self.is_shutdown = False


class LaunchConfiguration(Part):
    def perform(self, context: Context) -> Any:
        return resolve(self, context)


def resolve(value: Any, context: Context) -> Any:
    """Return the value of a substitution; other values are returned as they are."""
    kind = type(value).__name__
    if kind == "LaunchConfiguration":
        return context[value.arguments[0]]
    return value


_MODULES = {
    "launch": ["LaunchDescription"],
    "launch.actions": [
        "DeclareLaunchArgument",
        "ExecuteProcess",
        "IncludeLaunchDescription",
        "LogInfo",
        "OpaqueFunction",
    ],
    "launch.launch_description_sources": ["PythonLaunchDescriptionSource"],
    "launch.substitutions": ["LaunchConfiguration"],
    "launch_ros": [],
    "launch_ros.actions": ["Node"],
}


@contextmanager
def installed() -> Iterator[None]:
    """Let launch files import this replacement."""
    before = {name: sys.modules.get(name) for name in _MODULES}
    for name, classes in _MODULES.items():
        module: Any = ModuleType(name)
        for each in classes:
            known = globals().get(each)
            setattr(module, each, known or type(each, (Part,), {}))
        sys.modules[name] = module
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
