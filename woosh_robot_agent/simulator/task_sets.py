"""The task sets that every simulated chassis knows: those to start by number, those to call."""

from __future__ import annotations

from woosh_robot_agent.pb.task import task_pb2, woosh_task_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2

_PICK = util_task_pb2.kPick


def predefined_tasks() -> woosh_task_pb2.RepeatTasks:
    """The task sets that ExecPreTask can start.

    The delivery waits at its first mark for the order to go on.
    """
    delivery = _task_set(
        777,
        "delivery",
        _task("K10", util_task_pb2.kCarry, util_task_pb2.kFeeding, wait_time=-1),
        _task("U5", util_task_pb2.kCarry, util_task_pb2.kCutting),
        _task("P1", util_task_pb2.kParking),
    )
    sets = (
        (1, _task_set(666, "round", _task("A1"), _task("A10"))),
        (2, _task_set(1735291765, "supply", _task("K10"))),
        (1, delivery),
    )
    return woosh_task_pb2.RepeatTasks(
        repeat_tasks=[woosh_task_pb2.RepeatTask(times=times, task_set=each) for times, each in sets]
    )


def call_tasks() -> woosh_task_pb2.CallTasks:
    """The task sets that call buttons start."""
    info = woosh_task_pb2.CallInfo
    button = info.Caller(mac_addr="00:12:4b:00:1e:c5:7a:01", key_id=1)
    call = info(type=info.kOr, events=[info.CallEvent(caller=button, release=1)])
    task_set = _task_set(501, "call", _task("U5"))
    return woosh_task_pb2.CallTasks(
        call_tasks=[woosh_task_pb2.CallTask(call_info=call, task_set=task_set)]
    )


def _task(
    mark: str,
    kind: util_task_pb2.Type = _PICK,
    direction: util_task_pb2.Direction = util_task_pb2.kDirectionUndefined,
    *,
    wait_time: int = 0,
) -> task_pb2.TaskBase:
    """A task at a mark; a wait is in s, and -1 lasts until the order to go on."""
    return task_pb2.TaskBase(mark_no=mark, type=kind, direction=direction, wait_time=wait_time)


def _task_set(number: int, name: str, *bases: task_pb2.TaskBase) -> woosh_task_pb2.WooshTaskSet:
    tasks = []
    for index, base in enumerate(bases, start=1):
        base.id, base.name = index, f"{name} {index}"
        custom = woosh_task_pb2.WooshTask.Custom(executable=True)
        tasks.append(woosh_task_pb2.WooshTask(base=base, custom=custom))
    return woosh_task_pb2.WooshTaskSet(
        base=task_pb2.TaskSetBase(id=number, name=name, no=str(number), adapter="woosh"),
        tasks=tasks,
    )
