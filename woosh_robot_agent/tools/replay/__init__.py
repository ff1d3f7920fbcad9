"""The program `replay`: serves a recording as a chassis would."""

from woosh_robot_agent.tools.replay.program import main

__all__ = ["main"]
