"""The program `maps`: backs up the maps and marks of a robot, and brings them to a robot."""

from woosh_robot_agent.tools.start import program

main = program("woosh_robot_agent.tools.maps.program")
