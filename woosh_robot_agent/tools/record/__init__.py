"""The program `record`: writes all frames between a robot and its clients into a file."""

from woosh_robot_agent.tools.record.program import main

__all__ = ["main"]
