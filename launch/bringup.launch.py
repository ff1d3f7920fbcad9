"""Start the agent with transforms, and publish the robot model.

    ros2 launch woosh_robot_agent bringup.launch.py ip:=172.20.8.74

Arguments: those of agent.launch.py; urdf, your own model. If robot_state_publisher is not installed
(apt install ros-$ROS_DISTRO-robot-state-publisher), no model is published, and the agent publishes
the pose of the laser if the robot's firmware reports it.
"""

import re
from pathlib import Path

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchDescription
from launch.actions import LogInfo, OpaqueFunction
from launch_ros.actions import Node

from woosh_robot_agent.ros import launch_arguments

ARGUMENTS = ("ip", "port", "namespace", "frame_prefix", "nav2", "params_file", "urdf")
WILDCARDS = {"*": r"/\w+", "**": r"(/\w+)*"}
"""Wildcards in the node names of a parameter file, as regular expressions."""


def generate_launch_description():
    return LaunchDescription(
        [*launch_arguments.declare(*ARGUMENTS), OpaqueFunction(function=_nodes)]
    )


def _nodes(context):
    given = launch_arguments.values_of(context, __file__, *ARGUMENTS)
    node = f"/{given['namespace'].strip('/')}/agent".replace("//", "/")
    with_model = _is_installed("robot_state_publisher")
    agent = launch_arguments.agent_node(
        given,
        publish_tf=True,
        publish_laser_tf=not with_model,  # the model contains the pose of the laser
    )
    if not with_model:
        text = "robot_state_publisher is not installed, so the model is not published: "
        return [agent, LogInfo(msg=text + given["urdf"])]
    model = Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        namespace=given["namespace"],
        parameters=[
            {
                "robot_description": Path(given["urdf"]).read_text(),
                # the agent and the model must use the same prefix
                "frame_prefix": given["frame_prefix"]
                or _parameter_in(Path(given["params_file"]), node, "frame_prefix"),
            }
        ],
        output="screen",
    )
    return [agent, model]


def _parameter_in(path, node, parameter):
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
