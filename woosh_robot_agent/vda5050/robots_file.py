"""Read the robots of a parameter file of the agent, for the option `--robots`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from woosh_robot_agent.data_files import (
    DataFileError,
    load_yaml,
    parameter_sections,
    structure,
)
from woosh_robot_agent.link import LinkConfig

_NODE = "agent"
"""Name of the agent's node in the file."""


@dataclass(frozen=True)
class ListedRobot:
    """A robot in the file.

    Attributes:
        name: name in the list `robots`, without slashes at its ends.
        link: address of the robot, and options of its link.
        serial_number: serial number in the topics; empty for the one that the robot reports.
    """

    name: str
    link: LinkConfig
    serial_number: str


def read_robots(path: Path, default: LinkConfig) -> list[ListedRobot]:
    """Read the robots of a file.

    Args:
        path: a parameter file of the agent.
        default: options for links without options in the file; its address is not used.

    Raises:
        ValueError: the file cannot be read, or a robot in it is invalid; the text names the file.
    """
    try:
        return _robots(load_yaml(str(path), path.read_bytes()), default)
    except OSError as error:
        reason = error.strerror or str(error)
    except DataFileError:
        raise  # it names the file
    except ValueError as error:
        reason = str(error)
    raise ValueError(f"cannot use {path}: {reason}")


def _robots(content: Any, default: LinkConfig) -> list[ListedRobot]:
    """Return the robots in the content of a parameter file.

    Raises:
        ValueError: the content lists no robots, or a robot is invalid.
    """
    _check_sections(content)
    names = _parameters(content, f"/{_NODE}").get("robots")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise ValueError("list the names of the robots: /**: {ros__parameters: {robots: [r1, r2]}}")
    robots: list[ListedRobot] = []
    for name in (each.strip("/") for each in names):
        try:
            robot = _robot(name, _parameters(content, f"/{name}/{_NODE}"), default)
            _check_distinct(robot, robots)
        except ValueError as error:
            raise ValueError(f"robot {name}: {error}") from None
        robots.append(robot)
    return robots


def _check_sections(content: Any) -> None:
    """Raise ValueError if some of the content is in no section, e.g. after a typing error."""
    if not isinstance(content, dict):
        raise ValueError("it is not a parameter file: NODE: {ros__parameters: {NAME: VALUE}}")
    for key, value in content.items():
        if key != "ros__parameters" or not isinstance(value, dict):
            _check_sections(value)


def _parameters(content: Any, node: str) -> dict[str, Any]:
    """Return the parameters of a node from all sections for it; a later section wins."""
    found: dict[str, Any] = {}
    for _keys, parameters in parameter_sections(content, node):
        found |= parameters
    return found


def _robot(name: str, parameters: dict[str, Any], default: LinkConfig) -> ListedRobot:
    """Return a robot from its parameters; `default` has the options that they do not set.

    Raises:
        ValueError: a parameter is missing or invalid.
    """
    if not parameters.get("ip"):
        raise ValueError(f"it needs an ip; set it under /{name}/{_NODE}")
    # `parameters` also has those that are not of the link; `known_only=False` ignores them
    options = asdict(default) | parameters
    options["handshake_timeout"] = options["connect_timeout"]  # one parameter, as in the agent
    if "poll_timeout" in parameters:  # in milliseconds
        poll_timeout = structure(float, parameters["poll_timeout"], "its poll_timeout")
        options["request_timeout"] = poll_timeout / 1000
    link = structure(LinkConfig, options, "its parameters", known_only=False)
    serial_number = parameters.get("serial_number", "")
    if isinstance(serial_number, bool) or not isinstance(serial_number, str | int):
        raise ValueError(f"serial_number cannot be {serial_number!r}")
    return ListedRobot(name, link, str(serial_number))


def _check_distinct(robot: ListedRobot, others: list[ListedRobot]) -> None:
    """Raise ValueError if a robot has the name, address or serial number of another robot."""
    for other in others:
        if other.name == robot.name:
            raise ValueError("give each robot its own name; two have this one")
        one, two = robot.link, other.link
        # ports 0 are equal here, although they stand for a different port with each transport
        same_port = one.port == two.port or one.effective_port == two.effective_port
        if same_port and one.ip == two.ip:  # whatever their `robot_id`, which cancels do not carry
            raise ValueError(
                f"it has the address of robot {other.name}, {robot.link.address}; give each its "
                "own ip or port"
            )
        if robot.serial_number and other.serial_number == robot.serial_number:
            raise ValueError(f"it has the serial_number of robot {other.name}")
