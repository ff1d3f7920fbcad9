"""Start the agent.

    ros2 launch woosh_robot_agent agent.launch.py ip:=172.20.8.74

Arguments: ip and port of the chassis, namespace, frame_prefix, nav2 (true for Nav2's interfaces),
and params_file (config/agent.yaml lists all parameters). Arguments override the file. If the file
has a list of robots, as config/robots.yaml does, one process serves all of them; what the file sets
for a single robot overrides the arguments.
"""

from launch import LaunchDescription
from launch.actions import OpaqueFunction

from woosh_robot_agent.ros import launch_arguments

ARGUMENTS = ("ip", "port", "namespace", "frame_prefix", "nav2", "params_file")


def generate_launch_description():
    return LaunchDescription(
        [*launch_arguments.declare(*ARGUMENTS), OpaqueFunction(function=_agent)]
    )


def _agent(context):
    return [launch_arguments.agent_node(launch_arguments.values_of(context, __file__, *ARGUMENTS))]
