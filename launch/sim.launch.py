"""Start a simulated chassis on this machine, and everything that bringup.launch.py starts.

    ros2 launch woosh_robot_agent sim.launch.py

Arguments: namespace, frame_prefix, nav2, params_file and urdf as in bringup.launch.py; port, the
port of the simulated chassis, which overrides params_file; speed, the simulation speed (1 is real
time).
The end of the simulated chassis ends the launch.
"""

import socket
from pathlib import Path

from ament_index_python.packages import get_package_prefix
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    IncludeLaunchDescription,
    OpaqueFunction,
)
from launch.launch_description_sources import PythonLaunchDescriptionSource

from woosh_robot_agent.ros import launch_arguments

PACKAGE = launch_arguments.PACKAGE
SIMULATOR = Path(get_package_prefix(PACKAGE), "lib", PACKAGE, "simulator")
BRINGUP = launch_arguments.share("launch", "bringup.launch.py")
HOST = "127.0.0.1"
ARGUMENTS = ("namespace", "frame_prefix", "nav2", "params_file", "urdf")


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "port",
                default_value="5480",
                description="Port of the simulated chassis (0: any free port)",
            ),
            DeclareLaunchArgument(
                "speed", default_value="1", description="Simulation speed, 1 to 100; 1 is real time"
            ),
            *launch_arguments.declare(*ARGUMENTS),
            OpaqueFunction(function=_simulation),
        ]
    )


def _simulation(context):
    given = launch_arguments.values_of(context, __file__, "port", "speed", *ARGUMENTS)
    robots = launch_arguments.parameter_of_file(given, "robots") or []
    if any(robots):
        raise ValueError(  # the agent would connect to them instead
            f"{given['params_file']} sets robots to {robots}, but sim.launch.py simulates only "
            "one; remove that parameter from the file"
        )
    port = _free_port(launch_arguments.port_number(given["port"]))
    return [
        # a plain process: the simulator does not understand ROS arguments
        ExecuteProcess(
            cmd=[
                *(str(SIMULATOR), "--host", HOST, "--port", str(port)),
                *("--tcp-port", "0", "--speed", given["speed"]),
            ],
            name="simulator",
            output="screen",
            on_exit=_on_exit,
        ),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(BRINGUP)),
            launch_arguments=[
                ("ip", HOST),
                ("port", str(port)),
                *((name, given[name]) for name in ARGUMENTS),
            ],
        ),
    ]


def _free_port(port):
    """Return a port if it is free, or any free one for 0; raise ValueError if it is in use."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the simulator does
        try:
            probe.bind((HOST, port))
        except OSError as error:
            # the agent would connect to whatever is there
            raise ValueError(
                f"cannot use port {port} for the simulated chassis: {error.strerror}; choose "
                f"another one, e.g. port:={port + 10 if port < 65500 else 5490}, or port:=0 for "
                "any free one"
            ) from error
        return probe.getsockname()[1]


def _on_exit(event, context):
    """End the launch, so that the agent does not connect to another chassis on the same port."""
    if not context.is_shutdown:
        raise RuntimeError(f"the simulated chassis has ended, with status {event.returncode}")
