"""Handlers of requests about tasks and their navigation."""

from __future__ import annotations

import math

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.task import task_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import navigation_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.jobs import Job, Wait
from woosh_robot_agent.simulator.behaviour.mark_jobs import jobs_at_mark, leave_dock, work_jobs
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.behaviour.tasks import TaskOrder
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import (
    MAX_POSES,
    Handlers,
    Result,
    named_mark,
    pose,
    poses,
    usable_speed,
)
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Mark, MarkKind

_MAX_REPEATS = 100
"""Maximum number of repetitions of a task set. A set with more is repeated this often."""

_MIN_SPEED = 0.01
"""Minimum speed limit of a navigation, in m/s."""


def _exec_task(chassis: Chassis, request: pack.ExecTask) -> Result:
    # Clients may send all three targets, with the unused ones empty: a mark takes precedence over
    # a path, and a path over a pose.
    chassis.readiness.require_ready()
    kind, direction = request.type, request.direction
    jobs: list[Job]
    if request.mark_no:
        mark = _mark(chassis, request.mark_no, kind)
        jobs = jobs_at_mark(chassis, mark, kind, direction)
    elif request.plan_path.plan_path:
        via, strict = _route(request.plan_path)
        drive = Navigate(via.pop(), via, strict=strict)
        jobs = [*leave_dock(chassis), drive, *work_jobs(chassis, kind, direction)]
    elif request.HasField("pose"):
        drive = Navigate(pose(request.pose))
        jobs = [*leave_dock(chassis), drive, *work_jobs(chassis, kind, direction)]
    else:
        raise RefusedError(refusals.NO_TARGET)
    number = request.task_id or chassis.tasks.new_id()
    own_id = not request.task_id
    order = TaskOrder(number, kind, request.mark_no, jobs, own_id=own_id)
    chassis.ownership.start_tasks([order])
    return None


def _exec_pre_task(chassis: Chassis, request: pack.ExecPreTask) -> Result:
    chassis.readiness.require_ready()
    for repeat in chassis.scene.predefined.repeat_tasks:
        if repeat.task_set.base.id == request.task_set_id:
            times = min(max(1, repeat.times), _MAX_REPEATS)
            bases = [task.base for _ in range(times) for task in repeat.task_set.tasks]
            orders = [_of_set(chassis, request.task_set_id, base) for base in bases]
            chassis.ownership.start_tasks(orders)
            return None
    known = ", ".join(str(each.task_set.base.id) for each in chassis.scene.predefined.repeat_tasks)
    raise RefusedError(refusals.UNKNOWN_TASK_SET, task_set=request.task_set_id, task_sets=known)


def _of_set(chassis: Chassis, task_set: int, base: task_pb2.TaskBase) -> TaskOrder:
    mark = _mark(chassis, base.mark_no, base.type)
    jobs = jobs_at_mark(chassis, mark, base.type, base.direction)
    if base.wait_time:
        jobs.append(Wait(base.wait_time if base.wait_time > 0 else math.inf))
    return TaskOrder(task_set * 100 + base.id, base.type, base.mark_no, jobs)


def _mark(chassis: Chassis, number: str, kind: util_task_pb2.Type) -> Mark:
    mark = named_mark(chassis, number)
    if kind == util_task_pb2.kCharge and mark.kind is not MarkKind.CHARGER:
        raise RefusedError(refusals.NOT_A_CHARGER, mark=number)
    return mark


def _route(path: robot_pb2.PlanPath) -> tuple[list[Pose], bool]:
    """Return the poses of a path, and True if the robot must drive straight between them."""
    strict = all(segment.optimal == navigation_pb2.PlanPath.kStrict for segment in path.plan_path)
    route: list[Pose] = []
    for segment in path.plan_path:
        route += poses(segment.path.poses)
        if not segment.path.poses and segment.HasField("target"):
            route.append(pose(segment.target))
        if len(route) > MAX_POSES:
            raise RefusedError(refusals.PATH_TOO_LONG, limit=MAX_POSES)
    if not route:
        raise RefusedError(refusals.PATH_EMPTY)
    return route, strict


def _action_order(chassis: Chassis, request: pack.ActionOrder) -> Result:
    tasks, order = chassis.tasks, request.order
    if order == util_action_pb2.kPause:
        tasks.pause("paused", ordered=True)
    elif order in (util_action_pb2.kContinue, util_action_pb2.kReleaseCtrl):
        chassis.ownership.resume_task()
    elif order == util_action_pb2.kCancel:
        tasks.cancel("cancelled", ordered=True)
    elif order == util_action_pb2.kRecover:
        chassis.ownership.recover_task()
    elif order == util_action_pb2.kWaitBreak:
        tasks.end_wait()
    elif order == util_action_pb2.kTmCtrl:
        tasks.pause("held by traffic control", util_action_pb2.kTraffiCtrl, ordered=True)
    elif order == util_action_pb2.kStart:
        raise RefusedError(refusals.START_ORDER)
    else:
        raise RefusedError(refusals.UNKNOWN_ORDER, order=order)
    return None


def _change_nav_path(chassis: Chassis, request: pack.ChangeNavPath) -> Result:
    navigation = chassis.ownership.navigation
    if navigation is None:
        raise RefusedError(refusals.NO_NAVIGATION)
    via, strict = _route(request.paths)
    if via[-1] == navigation.goal:
        via.pop()
    navigation.change_path(chassis, via, strict=strict)
    return None


def _change_nav_mode(chassis: Chassis, request: pack.ChangeNavMode) -> Result:
    if chassis.ownership.navigation is None:
        raise RefusedError(refusals.NAVIGATION_MODE_UNUSED)
    if request.nav_mode.max_speed < 0.0:
        raise RefusedError(refusals.NEGATIVE_SPEED, speed=request.nav_mode.max_speed)
    usable_speed(request.nav_mode.max_speed, _MIN_SPEED)
    chassis.ownership.navigation.change_mode(request.nav_mode)
    return None


HANDLERS: Handlers = {
    pack.ExecTask: _exec_task,
    pack.ExecPreTask: _exec_pre_task,
    pack.ActionOrder: _action_order,
    pack.ChangeNavPath: _change_nav_path,
    pack.ChangeNavMode: _change_nav_mode,
}
