"""Several robots, each with an agent in a namespace of its own and a prefix for its frames.

    ros2 launch woosh_robot_agent fleet.launch.py robots:=my_robots.yaml

config/fleet.yaml shows the file: a list of robots with name and ip, and if need be port, namespace
(the name by default), frame_prefix (the name and a slash by default), params_file and urdf.
"""

from pathlib import Path

import yaml
from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

SHARE = Path(get_package_share_directory("woosh_robot_agent"))
DEFAULTS = {
    "port": "",
    "params_file": str(SHARE / "config" / "agent.yaml"),
    "urdf": str(SHARE / "config" / "woosh_base.urdf"),
}
"""Given for each robot: what bringup.launch.py is not given it takes from the robot before."""
KEYS = {"name", "ip", "namespace", "frame_prefix", *DEFAULTS}


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "robots",
                default_value=str(SHARE / "config" / "fleet.yaml"),
                description="File with the list of robots",
            ),
            OpaqueFunction(function=_robots),
        ]
    )


def _robots(context):
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(SHARE / "launch" / "bringup.launch.py")),
            launch_arguments=[(key, str(value)) for key, value in arguments.items()],
        )
        for arguments in fleet(Path(LaunchConfiguration("robots").perform(context)))
    ]


def fleet(path):
    """All arguments of bringup.launch.py for each robot; ValueError says what is wrong."""
    robots = yaml.safe_load(path.read_text())
    if not isinstance(robots, dict) or not isinstance(robots.get("robots"), list):
        raise ValueError(f"{path} has no list of robots: see config/fleet.yaml")
    found = []
    for robot in robots["robots"]:
        if not isinstance(robot, dict) or not {"name", "ip"} <= set(robot) <= KEYS:
            raise ValueError(f"{path}: a robot has name and ip, perhaps {sorted(KEYS)}: {robot}")
        given = {key: value for key, value in robot.items() if key != "name"}
        name = robot["name"]
        found.append({**DEFAULTS, "namespace": name, "frame_prefix": f"{name}/", **given})
    names = [each["namespace"] for each in found]
    if len(set(names)) < len(names):
        raise ValueError(f"{path}: two robots share a namespace: {names}")
    return found
