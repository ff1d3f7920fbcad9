"""Status of the robot's clock."""

from __future__ import annotations

from woosh_robot_agent.robot_clock import TOLERANCE, difference
from woosh_robot_agent.standard.diagnostics.status import WARN, Status


def clock_status(offset: float | None) -> Status:
    """Return the status of the robot's clock.

    Args:
        offset: time by which it is ahead of this computer's, in seconds; None if it is not known.
    """
    status = Status("clock")
    if offset is None:
        status.values = {"offset": "unknown, because the robot sends no times"}
        return status
    status.values = {"offset": f"{offset:.3f} s"}
    if abs(offset) > TOLERANCE:
        status.tell(
            WARN,
            f"the robot's clock is {difference(offset)}: synchronise both with the same time "
            "server (NTP); stamps of ROS messages are not affected, but the times in status codes "
            "and tasks are wrong by this difference",
        )
    return status
