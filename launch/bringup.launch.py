"""A robot with transforms: the agent with /tf, and the robot's model where it can be published.

    ros2 launch woosh_robot_agent bringup.launch.py ip:=172.20.8.74

Arguments: as agent.launch.py; frame_prefix, for several robots that share /tf, else params_file's;
urdf, a model of your own. Without robot_state_publisher (apt install
ros-jazzy-robot-state-publisher) there is no model, and the agent itself says where the laser is, if
the robot's firmware tells it.
"""

import re
from pathlib import Path

import yaml
from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
)
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

CONFIG = Path(get_package_share_directory("woosh_robot_agent"), "config")
WILDCARDS = {"*": r"/\w+", "**": r"(/\w+)*"}
"""What stands for one name, and for any number of them, where a parameter file names nodes."""


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "ip", default_value="", description="Address of the chassis; empty: params_file's"
            ),
            DeclareLaunchArgument(
                "port",
                default_value="",
                description="Its port, 0 the usual one; empty: params_file's",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="woosh_robot", description="Namespace of the robot"
            ),
            DeclareLaunchArgument(
                "frame_prefix",
                default_value="",
                description="Put before every frame, e.g. r1/; empty: params_file's",
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=str(CONFIG / "agent.yaml"),
                description="File with the agent's other parameters",
            ),
            DeclareLaunchArgument(
                "urdf",
                default_value=str(CONFIG / "woosh_base.urdf"),
                description="Model of the robot",
            ),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context):
    given = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("ip", "port", "namespace", "frame_prefix", "params_file", "urdf")
    }
    node = f"/{given['namespace'].strip('/')}/agent".replace("//", "/")
    kinds = {"ip": str, "port": int, "frame_prefix": str}
    with_model = _is_installed("robot_state_publisher")
    agent = Node(
        package="woosh_robot_agent",
        executable="agent",
        namespace=given["namespace"],
        parameters=[
            given["params_file"],
            {
                **{name: kind(given[name]) for name, kind in kinds.items() if given[name]},
                "publish_tf": True,
                # the model says it
                "publish_laser_tf": not with_model,
            },
        ],
        output="screen",
        emulate_tty=True,
    )
    if not with_model:
        return [agent]
    model = Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        namespace=given["namespace"],
        parameters=[
            {
                "robot_description": Path(given["urdf"]).read_text(),
                # frames of one robot hang together only if both say the same
                "frame_prefix": given["frame_prefix"]
                or _in_file(Path(given["params_file"]), node, "frame_prefix"),
            }
        ],
        output="screen",
    )
    return [agent, model]


def _in_file(path, node, parameter):
    """What a file says of a node, or ""; as in rclpy the last section that fits counts."""
    found = ""
    for name, values in _sections(yaml.safe_load(path.read_text()) or {}):
        pattern = "".join(WILDCARDS.get(part, f"/{re.escape(part)}") for part in name)
        if re.fullmatch(pattern, node):
            found = (values or {}).get(parameter, found)
    return found


def _sections(tree, above=()):
    """Every section of a parameter file: its name, split at the slashes, and its parameters."""
    for key, below in tree.items():
        if key == "ros__parameters":
            yield above, below
        elif isinstance(below, dict):
            yield from _sections(below, (*above, *str(key).strip("/").split("/")))


def _is_installed(package):
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True
