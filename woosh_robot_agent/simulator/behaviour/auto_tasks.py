"""The jobs of a task at its target, and the tasks that the robot gives itself."""

from __future__ import annotations

from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.behaviour.jobs import (
    Charge,
    Job,
    MoveLift,
    Shift,
    Steps,
    Wait,
    back_out,
)
from woosh_robot_agent.simulator.behaviour.navigation import PATH_MARGIN, Navigate
from woosh_robot_agent.simulator.behaviour.ownership import Ownership
from woosh_robot_agent.simulator.behaviour.tasks import TaskOrder, Tasks
from woosh_robot_agent.simulator.robot import Robot
from woosh_robot_agent.simulator.world.geometry import outer_radius
from woosh_robot_agent.simulator.world.maps import Mark, MarkKind


def jobs_at_mark(
    robot: Robot, mark: Mark, kind: util_task_pb2.Type, direction: util_task_pb2.Direction
) -> list[Job]:
    """Return the jobs of a task at a mark: drive there, dock if needed, do the work.

    A robot that carries something leaves the dock again. A robot that charges stays.
    """
    profile = robot.profile.charging
    work = work_jobs(robot, kind, direction)
    charge = kind == util_task_pb2.kCharge
    steps = profile.steps if charge else ()
    distance = profile.docking_distance
    start = mark.pose.moved(-distance - sum(steps), 0.0, 0.0)
    clearance = outer_radius(robot.outline) + PATH_MARGIN
    docks = (
        kind in (util_task_pb2.kCharge, util_task_pb2.kCarry)
        and robot.map.contains(*start.point)
        and robot.map.clearance(*start.point) >= clearance
    )
    if not docks:
        return [*leave_dock(robot), Navigate(mark.pose), *work]
    speed = profile.docking_speed
    way_in = [_move(distance, speed, util_action_pb2.kSecondposEnter)]
    way_in += [_move(step, profile.step_speed, util_action_pb2.kStepCtrl) for step in steps]
    way_out = [] if charge else [_move(-distance, speed, util_action_pb2.kSecondposQuit)]
    return [*leave_dock(robot), Navigate(start), *way_in, *work, *way_out]


def leave_dock(robot: Robot) -> list[Job]:
    """Return the jobs of a task before it drives: none, unless the robot stands in a dock."""
    leaves = robot.profile.tasks.leave_dock and robot.at_charger()
    return [back_out(robot)] if leaves else []


def work_jobs(
    robot: Robot, kind: util_task_pb2.Type, direction: util_task_pb2.Direction
) -> list[Job]:
    """Return the jobs of a task after its arrival; none for a task that only drives."""
    if kind == util_task_pb2.kCharge:
        return [Charge()]
    if kind == util_task_pb2.kCarry:
        unload = direction == util_task_pb2.kCutting
        return [MoveLift(robot.jack, 0.0 if unload else robot.jack.travel)]
    if kind != util_task_pb2.kParking and robot.profile.tasks.final_wait:
        return [Wait(0.0)]
    return []


def _move(distance: float, speed: float, kind: util_action_pb2.Type) -> Steps:
    return Steps([Shift(0.0, distance, speed)], avoid=True, kind=kind)


_PARKED_DISTANCE = 0.3
"""Distance from a parking place up to which a robot counts as parked, in metres."""


class AutoTasks:
    """Starts an automatic task when the robot has been idle for long enough.

    The robot is idle while it is ready, has no job, stands still, and no client has reserved it or
    sent a command. Any command of a client takes precedence over an automatic task.

    Args:
        robot: The robot.
        tasks: Its tasks.
        ownership: Starts the tasks.
        charge_after: Idle time before a robot with a low battery drives to a charger, in seconds.
        park_after: Idle time before a robot drives to a parking place, in seconds.
    """

    def __init__(
        self,
        robot: Robot,
        tasks: Tasks,
        ownership: Ownership,
        charge_after: float,
        park_after: float,
    ) -> None:
        self._robot = robot
        self._tasks = tasks
        self._ownership = ownership
        self._charge_after = charge_after
        self._park_after = park_after
        self._idle_time = 0.0
        """Time since the robot became idle, in seconds."""

    def postpone(self) -> None:
        """Restart the idle time, because a client has sent a command."""
        self._idle_time = 0.0

    def tick(self, dt: float) -> None:
        """Let `dt` seconds pass, and start or end an automatic task."""
        if not self._idle():
            self._idle_time = 0.0
            self._end_disallowed()
            return
        self._idle_time += dt
        setting, battery = self._robot.setting, self._robot.battery
        low = battery.percent <= setting.power.low
        if low and setting.allow.auto_charge and self._idle_time >= self._charge_after:
            self._start(MarkKind.CHARGER, util_task_pb2.kCharge)
        elif setting.allow.auto_park and self._idle_time >= self._park_after:
            self._start(MarkKind.PARKSPOT, util_task_pb2.kParking)

    def _idle(self) -> bool:
        robot = self._robot
        busy = self._ownership.busy or robot.base.moving or robot.battery.charges or robot.occupied
        return robot.readiness.ready and not busy

    def _end_disallowed(self) -> None:
        """Cancel an automatic task that the settings no longer allow."""
        if not self._tasks.automatic:
            return
        allow, kind = self._robot.setting.allow, self._tasks.proc.type
        if kind == util_task_pb2.kCharge and not allow.auto_charge:
            self._tasks.cancel("automatic charging is no longer allowed")
        elif kind == util_task_pb2.kParking and not allow.auto_park:
            self._tasks.cancel("automatic parking is no longer allowed")

    def _start(self, mark_kind: MarkKind, kind: util_task_pb2.Type) -> None:
        """Start a task at the nearest mark of a kind, unless the robot is already parked there."""
        robot = self._robot

        def distance(mark: Mark) -> float:
            return robot.base.pose.distance(mark.pose.point)

        marks = [mark for mark in robot.map.marks.values() if mark.kind is mark_kind]
        if not marks:
            return
        mark = min(marks, key=distance)
        if kind == util_task_pb2.kParking and distance(mark) <= _PARKED_DISTANCE:
            return
        jobs = jobs_at_mark(robot, mark, kind, util_task_pb2.kDirectionUndefined)
        order = TaskOrder(
            self._tasks.new_id(), kind, mark.number, lambda: jobs, automatic=True, own_id=True
        )
        self._ownership.start_tasks([order])
