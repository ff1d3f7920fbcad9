"""A robot with transforms: the agent with /tf, and the robot's model where it can be published.

    ros2 launch woosh_robot_agent bringup.launch.py ip:=172.20.8.74

Arguments: as agent.launch.py; frame_prefix, for several robots that share /tf; urdf, a model of
your own. Without robot_state_publisher (apt install ros-jazzy-robot-state-publisher) there is no
model, and the agent itself says where the laser is, if the robot's firmware tells it.
"""

from pathlib import Path

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


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "ip", default_value="", description="Address of the chassis; empty: the file's"
            ),
            DeclareLaunchArgument(
                "port",
                default_value="",
                description="Its port; empty: the file's, or the usual one",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="woosh_robot", description="Namespace of the robot"
            ),
            DeclareLaunchArgument(
                "frame_prefix",
                default_value="",
                description="Put before every frame, with its slash, e.g. r1/; empty: the file's",
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value="",
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
    with_model = _is_installed("robot_state_publisher")
    # the model says where the laser is
    values = {"publish_tf": True, "publish_laser_tf": not with_model}
    # what is not given leaves the file alone
    values |= {name: given[name] for name in ("ip", "frame_prefix") if given[name]}
    if given["port"]:
        values["port"] = int(given["port"])
    agent = Node(
        package="woosh_robot_agent",
        executable="agent",
        namespace=given["namespace"],
        parameters=[each for each in (given["params_file"], values) if each],
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
                "frame_prefix": given["frame_prefix"],
            }
        ],
        output="screen",
    )
    return [agent, model]


def _is_installed(package):
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True
