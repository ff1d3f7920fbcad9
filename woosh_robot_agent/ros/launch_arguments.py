"""Arguments that the launch files share, and the agent's node made from these arguments."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml
from ament_index_python import packages
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from woosh_robot_agent.data_files import parameter_sections

PACKAGE = "woosh_robot_agent"
DESCRIPTIONS = {
    "ip": "Address of the chassis; default: from params_file",
    "port": "Port of the chassis (0: standard port); default: from params_file",
    "namespace": "Namespace of the robot",
    "frame_prefix": "Prefix of every frame, e.g. r1/; default: from params_file",
    "nav2": "true for Nav2's actions, services and topics; default: from params_file",
    "params_file": "Parameter file of the agent",
    "urdf": "Robot model",
}
"""Descriptions of the arguments, by name."""

_LAUNCH_ARGUMENTS = {
    "emulate_tty",
    "launch-prefix",
    "launch-prefix-filter",
    "sigterm_timeout",
    "sigkill_timeout",
}
"""Arguments that `launch` itself takes from the command line."""
_PARAMETERS = ("ip", "port", "frame_prefix", "nav2")
"""Arguments that are parameters of the agent. Empty ones are not set."""


def share(*parts: str) -> Path:
    """Return a path in the package's share folder."""
    return Path(packages.get_package_share_directory(PACKAGE), *parts)


def defaults() -> dict[str, str]:
    """Return the default of each argument."""
    return dict.fromkeys(DESCRIPTIONS, "") | {
        "namespace": "woosh_robot",
        "params_file": str(share("config", "agent.yaml")),
        "urdf": str(share("config", "woosh_base.urdf")),
    }


def declare(*names: str) -> list[DeclareLaunchArgument]:
    """Return the launch actions that declare the arguments with these names."""
    default = defaults()
    return [
        DeclareLaunchArgument(name, default_value=default[name], description=DESCRIPTIONS[name])
        for name in names
    ]


def values_of(context: Any, file: str, *names: str) -> dict[str, str]:
    """Return the values of the arguments of a launch file, by name.

    Args:
        file: path of the launch file.
        names: all arguments that the launch file declares.

    Raises:
        ValueError: the command line has another argument, which `ros2 launch` would ignore.
    """
    if _is_on_command_line(file, sys.argv):
        on_command_line = {each.partition(":=")[0] for each in context.argv}
        if unknown := sorted(on_command_line - {*names} - _LAUNCH_ARGUMENTS):
            raise ValueError(
                f"{Path(file).name} has no argument {', '.join(unknown)}; it has {', '.join(names)}"
            )
    return {name: LaunchConfiguration(name).perform(context) for name in names}


def _is_on_command_line(file: str, command_line: Sequence[str]) -> bool:
    """Return True if the command line starts this launch file itself.

    Otherwise, another launch file includes it, and the command line may have further arguments.
    """
    path = Path(file)
    if (PACKAGE, path.name) in pairwise(command_line):  # ros2 launch PACKAGE FILE
        return True
    return any(  # ros2 launch PATH
        word.endswith(path.name) and Path(word).is_file() and path.samefile(word)
        for word in command_line
    )


def agent_node(arguments: Mapping[str, str], **parameters: object) -> Node:
    """Return the node of the agent.

    Args:
        arguments: values of launch arguments; they override the parameter file unless empty.
        parameters: further parameters, which override both.

    Raises:
        ValueError: the port is not a number from 0 to 65535, nav2 is neither true nor false, or the
            parameter file cannot be used.
    """
    values: dict[str, object] = {
        name: arguments[name] for name in _PARAMETERS if arguments.get(name)
    }
    if port := arguments.get("port"):
        values["port"] = port_number(port)
    if nav2 := arguments.get("nav2", "").lower():
        if nav2 not in ("true", "false"):
            raise ValueError(f"nav2 must be true or false, not {arguments['nav2']!r}")
        values["nav2"] = nav2 == "true"
    return Node(
        package=PACKAGE,
        executable="agent",
        namespace=arguments["namespace"],
        parameters=_parameters(arguments, values | parameters),
        output="screen",
        emulate_tty=True,
    )


def parameter_of_file(arguments: Mapping[str, str], parameter: str) -> Any:
    """Return a parameter of the agent from its parameter file; None if the file does not set it.

    Args:
        arguments: values of the launch arguments, of which `namespace` and `params_file` are used.
        parameter: name of the parameter.

    Raises:
        ValueError: the file cannot be used.
    """
    found = None
    for _keys, values in _agent_sections(arguments):  # as in ROS, the last section wins
        found = values.get(parameter, found)
    return found


def _parameters(
    arguments: Mapping[str, str], overrides: Mapping[str, object]
) -> list[str | Mapping[str, object]]:
    """Return what a launch file passes to the agent: the parameter file, and what overrides it.

    launch_ros passes the overrides in the section `/**`. A section of the agent in the file would
    win over that one: with its `ip`, a simulation would drive a real robot. Therefore another file
    repeats the overrides in each section that the parameter file has for the agent.
    """
    sections: dict[str, Any] = {}
    for keys, _values in _agent_sections(arguments):
        below = sections
        for key in keys:
            below = below.setdefault(key, {})
        below["ros__parameters"] = overrides
    parameters: list[str | Mapping[str, object]] = [arguments["params_file"], overrides]
    if overrides and sections:
        # kept until the node has read it, like the files of launch_ros
        with tempfile.NamedTemporaryFile("w", suffix=".yaml", delete=False) as file:
            json.dump(sections, file)  # JSON is YAML in which every text is quoted
        parameters.append(file.name)
    return parameters


def _agent_sections(
    arguments: Mapping[str, str],
) -> list[tuple[tuple[str, ...], dict[str, Any]]]:
    """Return the sections of the parameter file that are for the agent."""
    path = Path(arguments["params_file"])
    if not path.is_file():  # the agent would start without it
        raise ValueError(f"params_file is not a file: {path}")
    agent = f"/{arguments['namespace'].strip('/')}/agent".replace("//", "/")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8")) or {}  # ROS takes an empty file
        return list(parameter_sections(content, agent))
    except (ValueError, yaml.YAMLError) as error:
        raise ValueError(f"cannot use params_file {path}: {error}") from None


def port_number(text: str) -> int:
    """Return the value of an argument `port`.

    Raises:
        ValueError: the text is not a number from 0 to 65535.
    """
    if not text.isdecimal() or int(text) > 65535:
        raise ValueError(f"port must be a whole number from 0 to 65535, not {text!r}")
    return int(text)
