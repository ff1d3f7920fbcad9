"""Start the agent with transforms, and publish the robot model.

    ros2 launch woosh_robot_agent bringup.launch.py ip:=172.20.8.74

Arguments: those of agent.launch.py; frame_prefix, for several robots that share /tf (default: from
params_file); urdf, your own model. If robot_state_publisher is not installed (apt install
ros-jazzy-robot-state-publisher), no model is published, and the agent publishes the pose of the
laser if the robot's firmware reports it.
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
"""Wildcards in the node names of a parameter file, as regular expressions."""


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "ip",
                default_value="",
                description="Address of the chassis; default: from params_file",
            ),
            DeclareLaunchArgument(
                "port",
                default_value="",
                description="Port of the chassis (0: standard port); default: from params_file",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="woosh_robot", description="Namespace of the robot"
            ),
            DeclareLaunchArgument(
                "frame_prefix",
                default_value="",
                description="Prefix of every frame, e.g. r1/; default: from params_file",
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=str(CONFIG / "agent.yaml"),
                description="Parameter file of the agent",
            ),
            DeclareLaunchArgument(
                "urdf",
                default_value=str(CONFIG / "woosh_base.urdf"),
                description="Robot model",
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
                # the model contains the pose of the laser
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
                # the agent and the model must use the same prefix
                "frame_prefix": given["frame_prefix"]
                or _in_file(Path(given["params_file"]), node, "frame_prefix"),
            }
        ],
        output="screen",
    )
    return [agent, model]


def _in_file(path, node, parameter):
    """Return a node's parameter from a file, or ""; as in rclpy the last matching section wins."""
    found = ""
    for name, values in _sections(yaml.safe_load(path.read_text()) or {}):
        pattern = "".join(WILDCARDS.get(part, f"/{re.escape(part)}") for part in name)
        if re.fullmatch(pattern, node):
            found = (values or {}).get(parameter, found)
    return found


def _sections(tree, above=()):
    """Yield the name parts and the parameters of each section of a parameter file."""
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
