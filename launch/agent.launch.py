"""The agent alone.

    ros2 launch woosh_robot_agent agent.launch.py ip:=172.20.8.74

Arguments: ip and port of the chassis, namespace, and params_file (config/agent.yaml shows all
parameters). What is given here counts for more than the file.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    config = PathJoinSubstitution([FindPackageShare("woosh_robot_agent"), "config"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("ip", description="Address of the chassis"),
            DeclareLaunchArgument(
                "port", default_value="0", description="Its port; 0 is the usual one"
            ),
            DeclareLaunchArgument(
                "namespace", default_value="woosh_robot", description="Namespace of the agent"
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([config, "agent.yaml"]),
                description="File with the other parameters",
            ),
            Node(
                package="woosh_robot_agent",
                executable="agent",
                namespace=LaunchConfiguration("namespace"),
                parameters=[
                    LaunchConfiguration("params_file"),
                    {
                        "ip": ParameterValue(LaunchConfiguration("ip"), value_type=str),
                        "port": ParameterValue(LaunchConfiguration("port"), value_type=int),
                    },
                ],
                output="screen",
                emulate_tty=True,
            ),
        ]
    )
