"""/diagnostics: the state of link, robot and agent, from data that the agent already has.

Each module makes the statuses of one matter; `diagnostics` publishes them.
"""

from woosh_robot_agent.standard.diagnostics.diagnostics import Diagnostics

__all__ = ["Diagnostics"]
