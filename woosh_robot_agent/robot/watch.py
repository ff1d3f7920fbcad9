"""The observers of one robot: they log and explain, e.g. why a command was refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.robot.code_log import CodeLog, RefusalLog
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.robot.refusals import RefusalExplainer
from woosh_robot_agent.robot.standstill import Standstill
from woosh_robot_agent.robot.who_drives import VelocitySources, WhoDrives


class Watch:
    """All observers of one robot. Used in the event loop of the link.

    Args:
        goals: returns the names of the goals that the chassis executes.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        last_known: LastKnown,
        explainer: RefusalExplainer,
        goals: Callable[[], Sequence[str]],
    ) -> None:
        CodeLog(chassis)  # the subscriptions of the link keep it alive
        RefusalLog(gate, explainer)  # the gate keeps it alive
        self.velocities = VelocitySources(gate)
        self.standstill = Standstill(chassis, gate, last_known)
        self.who_drives = WhoDrives(chassis, gate, last_known, self.velocities, goals)
