"""The jobs of tasks, by the scene's table, and automatic tasks, which the robot starts itself."""

from __future__ import annotations

from collections.abc import Sequence

from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.behaviour.jobs import (
    STEP_SPEED,
    Charge,
    Job,
    MoveLift,
    Shift,
    Steps,
    Turn,
    Wait,
    dock,
    leave_charger,
)
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.behaviour.ownership import Ownership
from woosh_robot_agent.simulator.behaviour.tasks import TaskOrder, Tasks
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.robot import Robot
from woosh_robot_agent.simulator.scenes.action_groups import Action
from woosh_robot_agent.simulator.world.maps import Mark, MarkKind


def task_actions(robot: Robot, kind: util_task_pb2.Type, number: int) -> tuple[Action, ...]:
    """Return the actions of a task, by the table of the scene.

    Args:
        robot: the robot.
        kind: type of the task. A task without a type is a pick task.
        number: number of the task among the tasks of its type.

    Raises:
        RefusedError: the table has no actions for this task.
    """
    kind, groups = kind or util_task_pb2.kPick, robot.scene.action_groups
    actions = groups.actions(kind, number)
    if actions is None:
        known = ", ".join(map(str, groups.numbers(kind))) or "none"
        raise RefusedError(
            f"scene {robot.scene.name} has no actions for tasks of type {kind} with the number "
            f"{number}: the numbers of this type are {known}"
        )
    return actions


def task_jobs(
    robot: Robot,
    actions: Sequence[Action],
    direction: util_task_pb2.Direction,
    target: Mark | Navigate,
) -> list[Job]:
    """Return the jobs of a task. A robot that stands in a dock leaves it first.

    Without a mark there is no dock: the actions of docking are left out.

    Args:
        robot: the robot.
        actions: the actions of the task.
        direction: direction of a task that carries goods.
        target: the target mark of the task, or the job that drives to another target.
    """
    enters = any(each.action == util_action_pb2.kSecondposEnter for each in actions)
    docks = enters and isinstance(target, Mark)
    distance = 0.0
    if isinstance(target, Navigate):
        drive = target
    else:
        distance = robot.dock_distance(target) if docks else 0.0
        drive = Navigate(target.pose.moved(-distance, 0.0, 0.0))
    jobs = leave_dock(robot)
    for each in actions:
        kind = each.action
        if kind == util_action_pb2.kNav:
            jobs.append(drive)
        elif kind == util_action_pb2.kCarry:
            unloads = direction == util_task_pb2.kCutting
            jobs.append(MoveLift(robot.jack, 0.0 if unloads else robot.jack.travel))
        elif kind == util_action_pb2.kWait:
            if each.wait_time or robot.profile.tasks.final_wait:
                jobs.append(Wait(each.wait_time, each.wait_id))
        elif kind == util_action_pb2.kCharge:
            jobs.append(Charge())
        elif enters and not docks:
            continue
        elif kind == util_action_pb2.kSecondposEnter:
            jobs.append(dock(robot, distance, util_action_pb2.kSecondposEnter))
        elif kind == util_action_pb2.kSecondposQuit:
            jobs.append(dock(robot, -distance, util_action_pb2.kSecondposQuit))
        else:
            jobs.append(_step(robot, each))
    return jobs


def leave_dock(robot: Robot) -> list[Job]:
    """Return the jobs of a task before it drives: none, unless the robot stands in a dock."""
    leaves = robot.profile.tasks.leave_dock and robot.charger is not None
    return [leave_charger(robot)] if leaves else []


def _step(robot: Robot, action: Action) -> Job:
    speed, value = action.stepctrl_speed or STEP_SPEED, action.stepctrl_value
    if action.stepctrl_type:
        step: Shift | Turn = Turn(value, min(speed, robot.base.max_turn_rate))
    else:
        step = Shift(0.0, value, min(speed, robot.base.max_speed))
    return Steps([step], avoid=action.stepctrl_avoid)


def nearest_mark(robot: Robot, kind: MarkKind) -> Mark | None:
    """Return the nearest mark of a kind on the current map, None if there is none."""
    marks = [mark for mark in robot.map.marks.values() if mark.kind is kind]
    return min(marks, key=lambda mark: robot.pose.distance(mark.pose.point), default=None)


_PARKED_DISTANCE = 0.3
"""Distance from a parking place up to which a robot counts as parked, in metres."""


class AutoTasks:
    """Starts an automatic task, i.e. charging or parking, when the robot is idle for long enough.

    The robot is idle while it is ready, has no job, stands still, and no client has reserved it or
    sent a command. Any command of a client takes precedence over an automatic task.

    Args:
        robot: the robot.
        tasks: the tasks of the robot.
        ownership: starts the automatic tasks.
        charge_after: idle time before a robot with a low battery drives to a charger, in seconds.
        park_after: idle time before a robot drives to a parking place, in seconds.
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
        mark = nearest_mark(robot, mark_kind)
        actions = robot.scene.action_groups.actions(kind, 0)
        if mark is None or actions is None:
            return
        distance = robot.pose.distance(mark.pose.point)
        if kind == util_task_pb2.kParking and distance <= _PARKED_DISTANCE:
            return
        jobs = task_jobs(robot, actions, util_task_pb2.kDirectionUndefined, mark)
        order = TaskOrder(
            self._tasks.new_id(), kind, mark.number, lambda: jobs, automatic=True, own_id=True
        )
        self._ownership.start_tasks([order])
