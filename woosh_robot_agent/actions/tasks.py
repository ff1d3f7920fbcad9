"""Goals of robot/ExecTask: tasks, on which the chassis reports with woosh.robot.TaskProc."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.actions.attribution import Attribution
from woosh_robot_agent.actions.context import Context
from woosh_robot_agent.actions.kind import Findings, Report, Start
from woosh_robot_agent.actions.outcome import Outcome
from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder
from woosh_robot_agent.pb.robot.robot_pb2 import TaskHistory, TaskProc
from woosh_robot_agent.pb.util import action_pb2, task_pb2
from woosh_robot_agent.protos import full_name

_OUTCOMES = {
    task_pb2.kCompleted: Outcome.SUCCEEDED,
    task_pb2.kFailed: Outcome.ABORTED,
    task_pb2.kCanceled: Outcome.CANCELED,
}


class TaskIds:
    """Generator of unused task ids: Unix time in seconds, as other clients use it."""

    def __init__(self) -> None:
        self._last = 0

    def next(self) -> int:
        """Return an id above all earlier ones."""
        self._last = max(self._last + 1, int(time.time()))
        return self._last


class TaskGoal:
    """A task.

    Args:
        arg: the command, as the client gave it.
        context: objects shared by all tasks.
        ids: generates an id for a task that has none.
        last_known: last values that the chassis reported.
    """

    def __init__(self, arg: Any, context: Context, *, ids: TaskIds, last_known: LastKnown) -> None:
        self._arg = arg
        self._context = context
        self._id: int = arg.task_id or ids.next()
        self.name = f"task {self._id}"
        predecessors = context.open_goals.possibly_running(self.name)
        self._previous: TaskProc | None = None
        """The last report on an earlier task of this id."""
        last = last_known.get(full_name(TaskProc))
        if isinstance(last, TaskProc) and last.robot_task_id == self._id:
            self._previous = TaskProc()
            self._previous.CopyFrom(last)
            predecessors = max(predecessors, int(last.state not in _OUTCOMES))
        is_reused = predecessors > 0 or self._previous is not None
        self.attribution = Attribution(predecessors, Outcome if is_reused else ())

    def request(self) -> Start:
        request: Any = self._context.to_proto(self._arg)
        request.task_id = self._id
        return Start(request)

    def cancel_request(self) -> Message:
        return ActionOrder(order=action_pb2.kCancel)

    def read(self, message: Message) -> Iterable[Report]:
        if isinstance(message, TaskProc) and message.robot_task_id == self._id:
            return [_report(message)]
        return []

    async def poll(self) -> Findings:
        chassis, empty = self._context.chassis, self._context.empty
        answer = await chassis.request(empty(TaskProc))
        current = answer.body
        if not answer.ok or not isinstance(current, TaskProc):
            return Findings()
        if current.robot_task_id == self._id and current != self._previous:
            return Findings([_report(current)])
        answer = await chassis.request(empty(TaskHistory))
        if not answer.ok or not isinstance(answer.body, TaskHistory):
            return Findings()
        ended = [old for old in answer.body.tes if self._may_be_end(old)]
        if ended:
            return Findings([_report(max(ended, key=lambda old: old.time))])
        doing = f"task {current.robot_task_id}" if current.robot_task_id else "no task"
        return Findings(
            unknown=f"the chassis does not know the task any more; it is executing {doing}"
        )

    def failure(self, reason: str) -> Message:
        return TaskProc(
            robot_task_id=self._id,
            type=self._arg.type.value,
            state=task_pb2.kFailed,
            msg=reason,
            time=int(time.time()),
        )

    def _may_be_end(self, old: TaskProc) -> bool:
        """Return True if a history entry can be this task's end, not that of an earlier one."""
        return (
            old.robot_task_id == self._id
            and old.state in _OUTCOMES
            and old != self._previous
            and old.time >= (self._previous.time if self._previous is not None else 0)
        )


def _report(proc: TaskProc) -> Report:
    return Report(proc, _OUTCOMES.get(proc.state))
