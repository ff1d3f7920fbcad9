"""The program `maps`: backs up the maps and marks of a robot, and brings them to a robot."""

from woosh_robot_agent.tools.maps.program import main

__all__ = ["main"]
