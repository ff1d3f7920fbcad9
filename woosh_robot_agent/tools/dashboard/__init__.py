"""The program `dashboard`: a page in the browser that shows robots, and can drive them."""

from woosh_robot_agent.tools.dashboard.program import main

__all__ = ["main"]
