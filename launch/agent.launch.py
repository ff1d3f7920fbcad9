"""Start the agent.

    ros2 launch woosh_robot_agent agent.launch.py ip:=172.20.8.74

Arguments: ip and port of the chassis, namespace, and params_file (config/agent.yaml lists all
parameters). Arguments override the file. If the file has a list of robots, as config/robots.yaml
does, one process serves all of them.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

CONFIG = Path(get_package_share_directory("woosh_robot_agent"), "config")


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
                "namespace", default_value="woosh_robot", description="Namespace of the agent"
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=str(CONFIG / "agent.yaml"),
                description="Parameter file",
            ),
            OpaqueFunction(function=_agent),
        ]
    )


def _agent(context):
    def given(name):
        return LaunchConfiguration(name).perform(context)

    kinds = {"ip": str, "port": int}
    return [
        Node(
            package="woosh_robot_agent",
            executable="agent",
            namespace=given("namespace"),
            parameters=[
                given("params_file"),
                {name: kind(given(name)) for name, kind in kinds.items() if given(name)},
            ],
            output="screen",
            emulate_tty=True,
        )
    ]
