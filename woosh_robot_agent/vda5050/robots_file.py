"""The file that lists the robots of one process, in the form of the agent's parameter file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import yaml

from woosh_robot_agent.link import LinkConfig

_NODE = "agent"
"""Name of the node in the sections of the file."""
_PARAMETERS = "ros__parameters"
_TYPES: dict[str, tuple[type, ...]] = {
    field.name: {"str": (str,), "float": (int, float), "int": (int,)}.get(str(field.type), (str,))
    for field in fields(LinkConfig)
}
"""Types of the parameters of the link, by name."""


class RobotsFileError(Exception):
    """The file of the robots cannot be used. The text names the file and the reason."""


@dataclass(frozen=True)
class ListedRobot:
    """A robot in the file.

    Attributes:
        name: name in the list `robots`, without slashes at its ends.
        link: address of the robot, and options of its link.
        serial_number: serial number in the topics; empty for that of the robot.
    """

    name: str
    link: LinkConfig
    serial_number: str


def read_robots(path: Path, default: LinkConfig) -> list[ListedRobot]:
    """Read the robots of a file.

    Args:
        path: the file.
        default: the options of the link where the file has none; the address is not used.

    Raises:
        RobotsFileError: the file cannot be read, or a robot in it is invalid.
    """
    try:
        content = yaml.safe_load(path.read_text("utf-8"))
        return _robots(content, default)
    except OSError as error:
        reason = error.strerror or str(error)
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
    except ValueError as error:
        reason = str(error)
    raise RobotsFileError(f"cannot use {path}: {reason}")


def _robots(content: Any, default: LinkConfig) -> list[ListedRobot]:
    sections = list(_sections("", content))
    names = _parameters(sections, f"/{_NODE}").get("robots")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise ValueError("list the names of the robots: /**: {ros__parameters: {robots: [r1, r2]}}")
    robots: list[ListedRobot] = []
    for name in (each.strip("/") for each in names):
        try:
            robot = _robot(name, _parameters(sections, f"/{name}/{_NODE}"), default)
            _check_distinct(robot, robots)
        except ValueError as error:
            raise ValueError(f"robot {name}: {error}") from None
        robots.append(robot)
    return robots


def _sections(name: str, content: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the name and the parameters of each node; names may be nested or contain slashes."""
    if not isinstance(content, dict):
        raise ValueError("it is not a parameter file: NODE: {ros__parameters: {NAME: VALUE}}")
    for key, value in content.items():
        if key == _PARAMETERS and name and isinstance(value, dict):
            yield name, value
        else:
            yield from _sections(f"{name}/{str(key).strip('/')}", value)


def _parameters(sections: list[tuple[str, Mapping[str, Any]]], node: str) -> dict[str, Any]:
    """Return the parameters of a node from all sections that match it; later ones override."""
    found: dict[str, Any] = {}
    for pattern, parameters in sections:
        if re.fullmatch(_regex(pattern), node):
            found |= parameters
    return found


def _regex(pattern: str) -> str:
    """Return the regular expression for a name with `*` for one part, or `**` for any parts."""
    parts = {"*": "/[^/]+", "**": "(/[^/]+)*"}
    return "".join(parts.get(part, f"/{re.escape(part)}") for part in pattern.split("/")[1:])


def _robot(name: str, parameters: Mapping[str, Any], default: LinkConfig) -> ListedRobot:
    given = {key: value for key, value in parameters.items() if key in _TYPES}
    if not given.get("ip"):
        raise ValueError(f"it needs an ip; set it under /{name}/{_NODE}")
    for key, value in given.items():
        if isinstance(value, bool) or not isinstance(value, _TYPES[key]):
            raise ValueError(f"{key} cannot be {value!r}")
    serial_number = parameters.get("serial_number", "")
    if isinstance(serial_number, bool) or not isinstance(serial_number, str | int):
        raise ValueError(f"serial_number cannot be {serial_number!r}")
    return ListedRobot(name, replace(default, **given), str(serial_number))


def _check_distinct(robot: ListedRobot, others: list[ListedRobot]) -> None:
    for other in others:
        if other.name == robot.name:
            raise ValueError("give each robot its own name; two have this one")
        if other.link.addresses_same_robot(robot.link):
            raise ValueError(
                f"it has the address of robot {other.name}, {robot.link.address}; give each its "
                "own ip, port or robot_id"
            )
        if robot.serial_number and other.serial_number == robot.serial_number:
            raise ValueError(f"it has the serial_number of robot {other.name}")
