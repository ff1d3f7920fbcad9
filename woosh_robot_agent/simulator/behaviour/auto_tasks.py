"""What the chassis does of its own accord when nobody needs it: charge, and park."""

from __future__ import annotations

from typing import TYPE_CHECKING

from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.behaviour.mark_jobs import jobs_at_mark
from woosh_robot_agent.simulator.behaviour.tasks import TaskOrder
from woosh_robot_agent.simulator.world.maps import Mark, MarkKind

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.chassis import Chassis

_THERE_M = 0.3


class Errands:
    """Starts an automatic task when the chassis has been idle for long enough.

    It gives way to whatever a client wants: an errand is only ever begun by a robot that is ready
    and that nobody commanded, occupied or moved for the whole time.

    Args:
        charge_after: Idle s before a robot with a low battery drives to a charger.
        park_after: Idle s before a robot drives to a parking place.
    """

    def __init__(self, charge_after: float, park_after: float) -> None:
        self._charge_after = charge_after
        self._park_after = park_after
        self._idle = 0.0

    def postpone(self) -> None:
        """Begin to count anew: somebody works with the robot."""
        self._idle = 0.0

    def tick(self, chassis: Chassis, dt: float) -> None:
        """Let `dt` seconds pass, and start or end an errand."""
        if not _is_idle(chassis):
            self._idle = 0.0
            _end_forbidden(chassis)
            return
        self._idle += dt
        allow, battery = chassis.setting.allow, chassis.battery
        low = battery.percent <= chassis.setting.power.low
        if low and allow.auto_charge and self._idle >= self._charge_after:
            _start(chassis, MarkKind.CHARGER, util_task_pb2.kCharge)
        elif allow.auto_park and self._idle >= self._park_after:
            _start(chassis, MarkKind.PARKSPOT, util_task_pb2.kParking)


def _is_idle(chassis: Chassis) -> bool:
    busy = (
        chassis.tasks.active
        or chassis.actions.running
        or chassis.follower.active
        or chassis.base.moving
        or chassis.battery.charges
        or chassis.occupied
    )
    return chassis.taskable and not busy


def _end_forbidden(chassis: Chassis) -> None:
    """Break off an errand that the settings don't allow any more."""
    if not chassis.tasks.errand:
        return
    allow, kind = chassis.setting.allow, chassis.tasks.proc.type
    if kind == util_task_pb2.kCharge and not allow.auto_charge:
        chassis.tasks.cancel("automatic charging is not allowed any more")
    elif kind == util_task_pb2.kParking and not allow.auto_park:
        chassis.tasks.cancel("automatic parking is not allowed any more")


def _start(chassis: Chassis, where: MarkKind, kind: util_task_pb2.Type) -> None:
    """Drive to the nearest mark of a kind, if there is one and the robot isn't at one."""

    def distance(mark: Mark) -> float:
        return chassis.base.pose.distance(mark.pose.point)

    marks = [mark for mark in chassis.map.marks.values() if mark.kind is where]
    if not marks:
        return
    mark = min(marks, key=distance)
    if kind == util_task_pb2.kParking and distance(mark) <= _THERE_M:
        return
    jobs = jobs_at_mark(chassis, mark, kind, util_task_pb2.kDirectionUndefined)
    order = TaskOrder(chassis.fresh_task_id(), kind, mark.number, jobs, errand=True)
    chassis.take_tasks([order])
