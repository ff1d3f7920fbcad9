"""Start the agent with transforms, and publish the robot model.

    ros2 launch woosh_robot_agent bringup.launch.py ip:=172.20.8.74

Arguments: those of agent.launch.py; urdf, your own model. If robot_state_publisher is not installed
(apt install ros-$ROS_DISTRO-robot-state-publisher), no model is published, and the agent publishes
the pose of the laser if the robot's firmware reports it.
"""

from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchDescription
from launch.actions import LogInfo, OpaqueFunction
from launch_ros.actions import Node

from woosh_robot_agent.ros import launch_arguments

ARGUMENTS = ("ip", "port", "namespace", "frame_prefix", "nav2", "params_file", "urdf")


def generate_launch_description():
    return LaunchDescription(
        [*launch_arguments.declare(*ARGUMENTS), OpaqueFunction(function=_nodes)]
    )


def _nodes(context):
    given = launch_arguments.values_of(context, __file__, *ARGUMENTS)
    with_model = _is_installed("robot_state_publisher")
    agent = launch_arguments.agent_node(
        given,
        publish_tf=True,
        publish_laser_tf=not with_model,  # the model contains the pose of the laser
    )
    if not with_model:
        text = "robot_state_publisher is not installed, so the model is not published: "
        return [agent, LogInfo(msg=text + given["urdf"])]
    if not Path(given["urdf"]).is_file():
        raise ValueError(f"urdf is not a file: {given['urdf']}")
    model = Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        namespace=given["namespace"],
        parameters=[
            {
                "robot_description": Path(given["urdf"]).read_text(),
                # the agent and the model must use the same prefix
                "frame_prefix": given["frame_prefix"]
                or launch_arguments.parameter_of_file(given, "frame_prefix")
                or "",
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
