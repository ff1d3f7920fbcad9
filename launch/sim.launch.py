"""Start a simulated chassis on this machine, and everything that bringup.launch.py starts.

    ros2 launch woosh_robot_agent sim.launch.py

Arguments: namespace, frame_prefix, params_file and urdf as in bringup.launch.py; port, the port of
the simulated chassis, which overrides params_file; speed, the simulation speed (1 is real time).
"""

from pathlib import Path

from ament_index_python.packages import get_package_prefix
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from woosh_robot_agent import launch_arguments

PACKAGE = launch_arguments.PACKAGE
SIMULATOR = Path(get_package_prefix(PACKAGE), "lib", PACKAGE, "simulator")
BRINGUP = launch_arguments.share("launch", "bringup.launch.py")
ARGUMENTS = ("namespace", "frame_prefix", "params_file", "urdf")


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "port", default_value="5480", description="Port of the simulated chassis"
            ),
            DeclareLaunchArgument(
                "speed", default_value="1", description="Simulation speed, 1 to 100; 1 is real time"
            ),
            *launch_arguments.declare(*ARGUMENTS),
            # a plain process: the simulator does not understand ROS arguments
            ExecuteProcess(
                cmd=[
                    str(SIMULATOR),
                    "--port",
                    LaunchConfiguration("port"),
                    "--tcp-port",
                    "0",
                    "--speed",
                    LaunchConfiguration("speed"),
                ],
                name="simulator",
                output="screen",
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(str(BRINGUP)),
                launch_arguments=[
                    ("ip", "127.0.0.1"),
                    *((name, LaunchConfiguration(name)) for name in (*ARGUMENTS, "port")),
                ],
            ),
        ]
    )
