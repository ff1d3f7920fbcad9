"""Start a simulated chassis on this machine, and everything that bringup.launch.py starts.

    ros2 launch woosh_robot_agent sim.launch.py

Arguments: namespace, frame_prefix, params_file and urdf as in bringup.launch.py; port, the port of
the simulated chassis, which overrides params_file; speed, the simulation speed (1 is real time).
"""

from pathlib import Path

from ament_index_python.packages import get_package_prefix, get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

PACKAGE = "woosh_robot_agent"
SIMULATOR = Path(get_package_prefix(PACKAGE), "lib", PACKAGE, "simulator")
LAUNCH = Path(get_package_share_directory(PACKAGE), "launch")
CONFIG = Path(get_package_share_directory(PACKAGE), "config")


def generate_launch_description():
    passed_on = ("namespace", "frame_prefix", "params_file", "urdf", "port")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "port", default_value="5480", description="Port of the simulated chassis"
            ),
            DeclareLaunchArgument(
                "speed", default_value="1", description="Simulation speed, 1 to 100; 1 is real time"
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
                PythonLaunchDescriptionSource(str(LAUNCH / "bringup.launch.py")),
                launch_arguments=[
                    ("ip", "127.0.0.1"),
                    *((name, LaunchConfiguration(name)) for name in passed_on),
                ],
            ),
        ]
    )
