"""Status of the agents in the namespace."""

from __future__ import annotations

from woosh_robot_agent.second_agent import SecondAgent
from woosh_robot_agent.standard.diagnostics.status import WARN, Status


def agents_status(second_agent: SecondAgent) -> Status:
    """Return the status of the agents in the namespace; there should be one."""
    status = Status("agents")
    if second_agent.warning:
        status.tell(WARN, second_agent.warning)
    return status
