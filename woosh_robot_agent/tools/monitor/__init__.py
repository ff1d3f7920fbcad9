"""The program `monitor`: shows the state of one robot on a terminal."""

from woosh_robot_agent.tools.monitor.program import main

__all__ = ["main"]
