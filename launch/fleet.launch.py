"""Start several robots, each with its own agent process, namespace and frame prefix.

    ros2 launch woosh_robot_agent fleet.launch.py robots:=my_robots.yaml

config/fleet.yaml is an example of the file: a list of robots with name and ip, and optionally port,
namespace (default: the name), frame_prefix (default: the name and a slash), nav2, params_file and
urdf.
"""

from pathlib import Path

import yaml
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource

from woosh_robot_agent.ros import launch_arguments

DEFAULTS = {
    name: default
    for name, default in launch_arguments.defaults().items()
    if name in ("port", "nav2", "params_file", "urdf")
}
"""Passed for each robot, because an included file inherits the arguments of the previous one."""
KEYS = {"name", "ip", "namespace", "frame_prefix", *DEFAULTS}


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "robots",
                default_value=str(launch_arguments.share("config", "fleet.yaml")),
                description="File with the list of robots",
            ),
            OpaqueFunction(function=_robots),
        ]
    )


def _robots(context):
    file = launch_arguments.values_of(context, __file__, "robots")["robots"]
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(
                str(launch_arguments.share("launch", "bringup.launch.py"))
            ),
            launch_arguments=[(key, str(value)) for key, value in arguments.items()],
        )
        for arguments in fleet(Path(file))
    ]


def fleet(path):
    """Return the arguments of bringup.launch.py for each robot; raise ValueError for a bad file."""
    if not path.is_file():
        raise ValueError(f"robots is not a file: {path}")
    robots = yaml.safe_load(path.read_text())
    if not isinstance(robots, dict) or not isinstance(robots.get("robots"), list):
        raise ValueError(f"{path} has no list `robots`; see config/fleet.yaml for an example")
    found = []
    for robot in robots["robots"]:
        if not isinstance(robot, dict) or not {"name", "ip"} <= set(robot) <= KEYS:
            raise ValueError(
                f"{path}: each robot needs name and ip, and may have only the keys "
                f"{sorted(KEYS)}, not {robot}"
            )
        given = {key: value for key, value in robot.items() if key != "name"}
        name = robot["name"]
        prefix = f"{name}/".lstrip("/")  # frames do not begin with a slash
        found.append({**DEFAULTS, "namespace": name, "frame_prefix": prefix, **given})
    names = [str(each["namespace"]).strip("/") for each in found]
    if len(set(names)) < len(names):
        raise ValueError(f"{path}: two robots have the same namespace; give each its own: {names}")
    return found
