"""The jobs of a task, from the actions that `action_groups.json` of the scene lists."""

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
    dock_job,
    leave_charger_job,
)
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.robot import Robot
from woosh_robot_agent.simulator.scenes.action_groups import Action
from woosh_robot_agent.simulator.world.maps import Mark


def task_actions(robot: Robot, kind: util_task_pb2.Type, number: int) -> tuple[Action, ...]:
    """Return the actions of a task, as `action_groups.json` of the scene lists them.

    Args:
        robot: the robot, in the scene of the task.
        kind: type of the task; 0 for a pick task.
        number: the `task_type_no`, which distinguishes tasks of the same type.

    Raises:
        RefusedError: the file lists no actions for this task.
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
    """Return the jobs of a task, at least one.

    If the profile says so, a robot that stands at a charger leaves it first. A target that is not a
    mark has no dock. Actions that enter a dock are then left out, and with them the actions that
    leave it, and the steps in it.

    Args:
        robot: the robot, at the place where the task starts.
        direction: `kCutting` to unload goods, which lowers the lift; any other value raises it.
        target: the target mark of the task, or the job that drives to another target.
    """
    has_dock = any(each.action == util_action_pb2.kSecondposEnter for each in actions)
    distance = 0.0
    if isinstance(target, Navigate):
        drive = target
    else:
        distance = robot.dock_distance(target) if has_dock else 0.0
        drive = Navigate(target.pose.moved(-distance, 0.0, 0.0))
    jobs: list[Job] = []
    if robot.profile.tasks.leave_dock and robot.charger:
        jobs.append(leave_charger_job(robot, robot.charger))
    for each in actions:
        kind = each.action
        if kind == util_action_pb2.kNav:
            jobs.append(drive)
        elif kind == util_action_pb2.kCarry:
            unloads = direction == util_task_pb2.kCutting
            jobs.append(MoveLift(robot.jack, 0.0 if unloads else robot.jack.travel))
        elif kind == util_action_pb2.kWait:
            # With `final_wait`, waits of 0 s are done too, e.g. the one that ends a pick task.
            if each.wait_time or robot.profile.tasks.final_wait:
                jobs.append(Wait(each.wait_time, each.wait_id))
        elif kind == util_action_pb2.kCharge:
            jobs.append(Charge())
        elif has_dock and isinstance(target, Navigate):
            continue  # no dock to enter, to leave or to make steps in
        elif kind == util_action_pb2.kSecondposEnter:
            jobs.append(dock_job(robot, distance, util_action_pb2.kSecondposEnter))
        elif kind == util_action_pb2.kSecondposQuit:
            jobs.append(dock_job(robot, -distance, util_action_pb2.kSecondposQuit))
        else:
            jobs.append(_step(robot, each))
    return jobs or [Wait(0.0)]


def _step(robot: Robot, action: Action) -> Job:
    """Return the job of an action that is a step or a turn, within the limits of the base."""
    speed, value = action.stepctrl_speed or STEP_SPEED, action.stepctrl_value
    if action.stepctrl_type:  # a turn
        step: Shift | Turn = Turn(value, min(speed, robot.base.max_turn_rate))
    else:
        step = Shift(0.0, value, min(speed, robot.base.max_speed))
    return Steps([step], avoid=action.stepctrl_avoid)
