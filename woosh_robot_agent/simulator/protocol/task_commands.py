"""Handlers of requests about tasks and task sets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import count

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.task import task_pb2
from woosh_robot_agent.pb.task.woosh_task_pb2 import AddTask, RepeatTask, WooshTaskSet
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import navigation_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.jobs import Job, Wait
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.behaviour.task_jobs import task_actions, task_jobs
from woosh_robot_agent.simulator.behaviour.tasks import TaskOrder
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import (
    MAX_POSES,
    Result,
    command,
    named_mark,
    pose,
    poses,
    usable_speed,
)
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.action_groups import Action
from woosh_robot_agent.simulator.scenes.scene import set_predefined
from woosh_robot_agent.simulator.timeline import copy_of
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Mark, MarkKind


@command(pack.ExecTask)
def _exec_task(chassis: Chassis, request: pack.ExecTask) -> None:
    chassis.readiness.require_ready()
    kind = request.type
    target = _target(chassis, request)
    if not kind:
        raise RefusedError("the task has no type: set type to 1 pick, 2 park, 3 charge or 4 carry")
    actions = task_actions(chassis, kind, request.task_type_no)
    jobs = task_jobs(chassis, actions, request.direction, target)
    number = request.task_id or chassis.tasks.new_id()
    dest = target.number if isinstance(target, Mark) else ""
    # The task starts at once, so its jobs are already known.
    order = TaskOrder(number, kind, dest, jobs=lambda: jobs, own_id=not request.task_id)
    chassis.ownership.start_tasks([order])


def _target(chassis: Chassis, request: pack.ExecTask) -> Mark | Navigate:
    """Return the target mark of a task, or the job that drives to another target.

    Clients may send all three kinds of targets, with the unused ones empty: a mark takes precedence
    over a path, and a path over a pose. A charge task whose pose is missing or empty leads to the
    nearest charger.
    """
    if request.mark_no:
        mark = named_mark(chassis, request.mark_no)
        _require_suitable(mark, request.type)
        return mark
    if request.plan_path.plan_path:
        via, strict = _route(request.plan_path)
        return Navigate(via.pop(), via, strict=strict)
    if request.type == util_task_pb2.kCharge and pose(request.pose) == Pose():
        charger = chassis.nearest_mark(MarkKind.CHARGER)
        if charger is None:
            raise RefusedError(
                f"map {chassis.map.name} has no charger: add a mark of this type, or name another "
                "target"
            )
        return charger
    if request.HasField("pose"):
        return Navigate(pose(request.pose))
    raise RefusedError("the task has no target: give mark_no, plan_path or pose")


def _route(path: robot_pb2.PlanPath) -> tuple[list[Pose], bool]:
    """Return the poses of a path, and True if the robot must drive straight between them."""
    strict = all(segment.optimal == navigation_pb2.PlanPath.kStrict for segment in path.plan_path)
    route: list[Pose] = []
    for segment in path.plan_path:
        route += poses(segment.path.poses)
        if not segment.path.poses and segment.HasField("target"):
            route.append(pose(segment.target))
        if len(route) > MAX_POSES:
            raise RefusedError(f"the path has more than {MAX_POSES} poses: send fewer")
    if not route:
        raise RefusedError(refusals.PATH_EMPTY)
    return route, strict


@command(pack.ActionOrder)
def _action_order(chassis: Chassis, request: pack.ActionOrder) -> None:
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
        raise RefusedError("order 1 (start) is not supported: a task starts by itself")
    else:
        raise RefusedError(f"unknown order {order}: 2 is pause, 3 continue, 4 cancel, 5 recover")


@command(pack.ChangeNavPath)
def _change_nav_path(chassis: Chassis, request: pack.ChangeNavPath) -> None:
    navigation = chassis.ownership.navigation
    if navigation is None:
        raise RefusedError(refusals.NO_NAVIGATION)
    via, strict = _route(request.paths)
    if via[-1] == navigation.goal:
        via.pop()
    navigation.change_path(chassis, via, strict=strict)


@command(pack.ChangeNavMode)
def _change_nav_mode(chassis: Chassis, request: pack.ChangeNavMode) -> None:
    if chassis.ownership.navigation is None:
        raise RefusedError(refusals.NAVIGATION_MODE_UNUSED)
    if request.nav_mode.max_speed < 0.0:
        raise RefusedError(
            f"max_speed {request.nav_mode.max_speed:g} is negative: use 0 for the default"
        )
    usable_speed(request.nav_mode.max_speed)  # refuses one that is too slow
    chassis.ownership.navigation.change_mode(request.nav_mode)


_MAX_REPEATS = 100
"""Maximum number of times that a task set is run."""

_MAX_SETS = 200
"""Maximum number of predefined task sets of a scene."""

_MAX_TASKS = 99
"""Maximum number of tasks of a set: a robot_task_id has two digits for the task in its set."""

_MAX_BYTES = 64 * 1024
"""Maximum size of a request that contains a task set, in bytes."""


@command(pack.ExecPreTask)
def _exec_pre_task(chassis: Chassis, request: pack.ExecPreTask) -> None:
    chassis.readiness.require_ready()
    repeat = _predefined(chassis, request.task_set_id)
    _start(chassis, repeat.task_set, repeat.times)


@command(pack.ExecTaskSet)
def _exec_task_set(chassis: Chassis, request: pack.ExecTaskSet) -> None:
    raise RefusedError(
        "ExecTaskSet names no task set, and real chassis do not implement it: send "
        "ExecPreTask, or RepeatTask with order 3"
    )


@command(RepeatTask)
def _repeat_task(chassis: Chassis, request: RepeatTask) -> Result:
    _check_size(request)
    if request.order == RepeatTask.kPut:
        return _put(chassis, request)
    if request.order == RepeatTask.kDel:
        _delete(chassis, request)
    # Older clients set no order: for them, the request runs a task set.
    elif request.order in (RepeatTask.kExec, RepeatTask.kOrderUndefined):
        _exec(chassis, request)
    else:
        raise RefusedError(f"unknown order {request.order}: 1 is put, 2 delete, 3 execute")
    return None


@command(AddTask)
def _add_task(chassis: Chassis, request: AddTask) -> None:
    """Run a task set once. It is refused in the same cases as ExecTask: there is no queue."""
    chassis.readiness.require_ready()
    _check_size(request)
    _start(chassis, _checked_set(chassis, request.tset), 1)


def _put(chassis: Chassis, request: RepeatTask) -> Message:
    """Add a predefined task set, or replace the one with the same id; return the stored set.

    A set with the id 0 is added with the first free id from the robot's Unix time on.
    """
    sets = {each.task_set.base.id: each for each in chassis.scene.predefined.repeat_tasks}
    kept = copy_of(request)
    kept.ClearField("order")
    base = kept.task_set.base
    if not base.id:
        base.id = next(each for each in count(int(chassis.time)) if each not in sets)
    if base.id not in sets and len(sets) >= _MAX_SETS:
        raise RefusedError(f"there are already {_MAX_SETS} task sets: delete one of them first")
    _number_and_check_tasks(chassis, kept.task_set)
    kept.times = _checked_times(kept.times)
    base.no = base.no or str(base.id)
    base.adapter = base.adapter or "woosh"
    sets[base.id] = kept
    set_predefined(chassis.scene, sets.values())
    return kept


def _delete(chassis: Chassis, request: RepeatTask) -> None:
    """Delete a predefined task set. A running task set goes on."""
    id_ = request.task_set.base.id
    _predefined(chassis, id_)  # refuses an unknown id
    sets = chassis.scene.predefined.repeat_tasks
    kept = [each for each in sets if each.task_set.base.id != id_]
    set_predefined(chassis.scene, kept)


def _exec(chassis: Chassis, request: RepeatTask) -> None:
    """Run the tasks in the request; without tasks, run the predefined set with the given id.

    They run `times` times. If `times` is 0, the tasks in the request run once, and the predefined
    set as often as it says.
    """
    chassis.readiness.require_ready()
    times = _checked_times(request.times)
    if request.task_set.tasks:
        _start(chassis, _checked_set(chassis, request.task_set), times)
    else:
        predefined = _predefined(chassis, request.task_set.base.id)
        _start(chassis, predefined.task_set, times if request.times else predefined.times)


def _check_size(request: Message) -> None:
    if request.ByteSize() > _MAX_BYTES:
        raise RefusedError(f"the task set has more than {_MAX_BYTES} bytes: give a smaller one")


def _checked_set(chassis: Chassis, given: WooshTaskSet) -> WooshTaskSet:
    """Return a checked copy of a task set. It has ids where `given` has none."""
    task_set = copy_of(given)
    task_set.base.id = task_set.base.id or int(chassis.time)
    _number_and_check_tasks(chassis, task_set)
    return task_set


def _predefined(chassis: Chassis, id_: int) -> RepeatTask:
    """Return the predefined task set with an id; raise RefusedError if there is none."""
    for repeat in chassis.scene.predefined.repeat_tasks:
        if repeat.task_set.base.id == id_:
            return repeat
    known = ", ".join(str(each.task_set.base.id) for each in chassis.scene.predefined.repeat_tasks)
    raise RefusedError(refusals.UNKNOWN_TASK_SET, task_set=id_, task_sets=known or "none")


def _number_and_check_tasks(chassis: Chassis, task_set: WooshTaskSet) -> None:
    """Check a task set and its tasks, and number the tasks if none of them has an id."""
    tasks = task_set.tasks
    if task_set.base.id < 0:
        raise RefusedError(f"task set id {task_set.base.id} is negative: give a positive one, or 0")
    if not 0 < len(tasks) <= _MAX_TASKS:
        raise RefusedError(f"the task set has {len(tasks)} tasks: give 1 to {_MAX_TASKS}")
    if not any(task.base.id for task in tasks):
        for number, task in enumerate(tasks, start=1):
            task.base.id = number
    ids = [task.base.id for task in tasks]
    if len(set(ids)) < len(ids) or not all(0 < each <= _MAX_TASKS for each in ids):
        raise RefusedError(
            f"task ids {ids} must be different numbers from 1 to {_MAX_TASKS}, or all 0"
        )
    marks = {number: mark for area in chassis.scene.maps for number, mark in area.marks.items()}
    for task in tasks:
        mark = marks.get(task.base.mark_no)
        if mark is None:
            raise RefusedError(
                f"unknown mark {task.base.mark_no}: no map of scene {chassis.scene.name} has it"
            )
        _require_suitable(mark, task.base.type)
        task_actions(chassis, task.base.type, task.base.type_no)


def _require_suitable(mark: Mark, kind: util_task_pb2.Type) -> None:
    """Raise RefusedError for a charge task (`kind`) at a mark that is not a charger."""
    if kind == util_task_pb2.kCharge and mark.kind is not MarkKind.CHARGER:
        raise RefusedError(f"mark {mark.number} is not a charger: choose one that is")


def _checked_times(times: int) -> int:
    """Return how often to run a task set; 0 in a request stands for once."""
    if not 0 <= times <= _MAX_REPEATS:
        raise RefusedError(f"{times} repetitions are not within 0 to {_MAX_REPEATS}")
    return times or 1


def _start(chassis: Chassis, task_set: WooshTaskSet, times: int) -> None:
    """Start a task set, to be run `times` times.

    Files may have any number: less than 1 counts as 1, more than `_MAX_REPEATS` as `_MAX_REPEATS`.
    """
    set_id = task_set.base.id
    if not task_set.tasks:  # only the sets in uploaded files may have none
        raise RefusedError(f"task set {set_id} has no tasks: put it with at least one")
    times = min(max(1, times), _MAX_REPEATS)
    bases = [task.base for _ in range(times) for task in task_set.tasks]
    chassis.ownership.start_tasks([_task_order(chassis, set_id, base) for base in bases])


def _task_order(chassis: Chassis, set_id: int, base: task_pb2.TaskBase) -> TaskOrder:
    """Return the order for a task of a set; raise RefusedError if the task is impossible."""
    mark = named_mark(chassis, base.mark_no)
    _require_suitable(mark, base.type)
    actions = task_actions(chassis, base.type, base.type_no)
    jobs = partial(_jobs, chassis, mark, actions, base)
    # Clients find the set in the id of its tasks: the last two digits are the task.
    return TaskOrder(set_id * 100 + base.id, base.type, base.mark_no, jobs)


def _jobs(
    chassis: Chassis, mark: Mark, actions: Sequence[Action], base: task_pb2.TaskBase
) -> list[Job]:
    """Return the jobs of a task of a set."""
    jobs = task_jobs(chassis, actions, base.direction, mark)
    if base.wait_time:
        # A negative time is a wait until a client continues the task.
        jobs.append(Wait(base.wait_time if base.wait_time > 0 else math.inf))
    return jobs
