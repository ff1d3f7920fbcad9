"""Arguments that the launch files share, and the node of the agent that they set."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ament_index_python import packages
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PACKAGE = "woosh_robot_agent"
DESCRIPTIONS = {
    "ip": "Address of the chassis; default: from params_file",
    "port": "Port of the chassis (0: standard port); default: from params_file",
    "namespace": "Namespace of the robot",
    "frame_prefix": "Prefix of every frame, e.g. r1/; default: from params_file",
    "params_file": "Parameter file of the agent",
    "urdf": "Robot model",
}
"""Descriptions of the arguments, by name."""

_PARAMETERS = ("ip", "port", "frame_prefix")
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
    """Return the declarations of some of the arguments."""
    values = defaults()
    return [
        DeclareLaunchArgument(name, default_value=values[name], description=DESCRIPTIONS[name])
        for name in names
    ]


def given(context: Any, *names: str) -> dict[str, str]:
    """Return the values of some arguments in a launch context."""
    return {name: LaunchConfiguration(name).perform(context) for name in names}


def agent(arguments: Mapping[str, str], **parameters: object) -> Node:
    """Return the node of the agent.

    Args:
        arguments: values of launch arguments; they override the parameter file.
        parameters: further parameters, which override both.

    Raises:
        ValueError: the port is not a number.
    """
    values: dict[str, object] = {
        name: arguments[name] for name in _PARAMETERS if arguments.get(name)
    }
    if port := arguments.get("port"):
        values["port"] = _port(port)
    return Node(
        package=PACKAGE,
        executable="agent",
        namespace=arguments["namespace"],
        parameters=[arguments["params_file"], {**values, **parameters}],
        output="screen",
        emulate_tty=True,
    )


def _port(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise ValueError(f"port must be a whole number, not {text!r}") from None
