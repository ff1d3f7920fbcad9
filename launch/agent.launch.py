"""The agent alone.

    ros2 launch woosh_robot_agent agent.launch.py ip:=172.20.8.74

Arguments: ip and port of the chassis, namespace, and params_file (config/agent.yaml shows all
parameters). What is given here counts for more than the file, what is not leaves the file alone.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


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
                "namespace", default_value="woosh_robot", description="Namespace of the agent"
            ),
            DeclareLaunchArgument(
                "params_file", default_value="", description="File with the other parameters"
            ),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context):
    given = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("ip", "port", "namespace", "params_file")
    }
    values = {"ip": given["ip"]} if given["ip"] else {}
    if given["port"]:
        values["port"] = int(given["port"])
    return [
        Node(
            package="woosh_robot_agent",
            executable="agent",
            namespace=given["namespace"],
            parameters=[each for each in (given["params_file"], values) if each],
            output="screen",
            emulate_tty=True,
        )
    ]
