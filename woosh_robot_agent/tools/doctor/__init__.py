"""The program `doctor`: checks the connection to a robot and whether it accepts tasks."""

from woosh_robot_agent.tools.start import program

main = program("woosh_robot_agent.tools.doctor.program")
