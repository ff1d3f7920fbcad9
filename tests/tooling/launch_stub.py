"""A minimal replacement of ROS's `launch`, which is not on PyPI. It can load our launch files."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from types import ModuleType
from typing import Any
from unittest import mock


class Part:
    """Stand-in for any object that a launch file creates; stores its arguments."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        self.arguments = arguments
        self.named = named

    def __getattr__(self, name: str) -> Any:
        return self.named[name]


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
    is_substitution = type(value).__name__ == "LaunchConfiguration"
    return context[value.arguments[0]] if is_substitution else value


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


def installed() -> AbstractContextManager[Any]:
    """Let launch files import this replacement."""
    modules = {name: ModuleType(name) for name in _MODULES}
    for name, classes in _MODULES.items():
        for each in classes:
            setattr(modules[name], each, globals().get(each) or type(each, (Part,), {}))
    return mock.patch.dict(sys.modules, modules)
