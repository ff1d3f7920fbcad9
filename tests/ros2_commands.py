"""Parser of the documented commands. It parses as the shell and the `ros2` tool do."""

from __future__ import annotations

import array
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from woosh_robot_agent import endpoints
from woosh_robot_agent.convert.mapping import class_of

NAMESPACE = f"{endpoints.NAMESPACE}/"


@dataclass(frozen=True)
class Command:
    """A documented command.

    Attributes:
        line: the command line.
        verb: `service call`, `topic echo` or `action send_goal`.
        name: name of the endpoint, relative to the namespace.
        type: its ROS type, e.g. `woosh_robot_msgs/srv/Mode`; empty for a topic.
        values: the request or goal as YAML.
    """

    line: str
    verb: str
    name: str
    type: str = ""
    values: str = "{}"

    def filled(self) -> Any:
        """Return the request or the goal.

        Raises:
            yaml.YAMLError, AttributeError, TypeError, ValueError: the tool would reject it, too.
        """
        cls = self.cls
        message = (cls.Request if self.verb == "service call" else cls.Goal)()
        set_message_fields(message, yaml.safe_load(self.values))
        return message

    @property
    def cls(self) -> Any:
        package, kind, short = self.type.split("/")
        return class_of(f"{package}/{short}", kind)


def parse(line: str) -> Command:
    """Parse a command line.

    Raises:
        ValueError: the tool would reject the number of arguments, or the name is not the agent's.
    """
    ros2, group, verb, path, *rest = shlex.split(line)
    rest = [word for word in rest if word != "--feedback"]
    if ros2 != "ros2" or not path.startswith(NAMESPACE) or len(rest) > 2:
        raise ValueError(f"not a command: {line}")
    return Command(line, f"{group} {verb}", path.removeprefix(NAMESPACE), *rest)


def documented() -> list[Command]:
    """Return all documented commands, in the order of the document."""
    text = (Path(__file__).parent / "documented_commands.txt").read_text()
    return [parse(line) for line in text.splitlines()]


try:
    from rosidl_runtime_py import set_message_fields
except ImportError:  # not on PyPI; the replacement suffices for the field types of our messages

    def set_message_fields(msg: Any, values: Any) -> None:
        """Set the fields named in `values`; the others keep their defaults."""
        types = msg.get_fields_and_field_types()
        for name, value in values.items():
            old = getattr(msg, name)
            item = types[name].removeprefix("sequence<").rstrip(">")
            if isinstance(old, array.array):
                new: Any = array.array(old.typecode, value)
            elif isinstance(old, list) and "/" in item:
                new = [_filled(item, each) for each in value]
            elif "/" in item:
                new = _filled(item, value)
            else:
                new = type(old)(value)
            setattr(msg, name, new)

    def _filled(kind: str, values: Any) -> Any:
        message = class_of(kind, "msg")()
        set_message_fields(message, values)
        return message
