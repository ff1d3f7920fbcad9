"""Status of the motion: what drives the robot, and what hinders it."""

from __future__ import annotations

from woosh_robot_agent.standard.diagnostics.status import WARN, Status
from woosh_robot_agent.watch import velocity_sources
from woosh_robot_agent.watch.watch import Watch


def motion_status(watch: Watch) -> Status:
    """Return the status of the motion."""
    status = Status("motion")
    driver = watch.who_drives.now()
    status.fine = f"{driver.name}: {driver.detail}" if driver.detail else driver.name
    status.values = {"driver": driver.name, "detail": driver.detail}
    if sources := watch.velocities.simultaneous:
        status.tell(WARN, velocity_sources.warning(sources))
    if warning := watch.standstill.warning:
        status.tell(WARN, warning)
    return status
