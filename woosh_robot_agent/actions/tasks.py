"""Goals of robot/ExecTask: tasks, on which the chassis reports with woosh.robot.TaskProc."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.actions.attribution import Attribution
from woosh_robot_agent.actions.context import Context
from woosh_robot_agent.actions.kind import Findings, Report, Start
from woosh_robot_agent.actions.outcome import Outcome
from woosh_robot_agent.actions.task_polls import poll_tasks
from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.pb.util import action_pb2, task_pb2
from woosh_robot_agent.protos import full_name
from woosh_robot_agent.recent_dict import RecentDict

OUTCOMES = {
    task_pb2.kCompleted: Outcome.SUCCEEDED,
    task_pb2.kFailed: Outcome.ABORTED,
    task_pb2.kCanceled: Outcome.CANCELED,
}
"""Outcomes of the states in which a task has ended."""
_MAX_REPORTS = 100
"""Maximum number of tasks whose last report is remembered."""


class TaskIds:
    """Generator of unused task ids: Unix time in seconds, as other clients use it."""

    def __init__(self) -> None:
        self._last = 0
        """The last id that was returned."""

    def next(self) -> int:
        """Return an id above all earlier ones."""
        self._last = max(self._last + 1, int(time.time()))
        return self._last


class LastReports:
    """The last report on each of the latest tasks.

    The last known TaskProc is not enough: a chassis follows the end of a task with an empty one.
    """

    def __init__(self) -> None:
        self._reports: RecentDict[int, TaskProc] = RecentDict(_MAX_REPORTS)
        """By task id."""

    def add(self, report: TaskProc) -> None:
        """Remember a report, unless it is about no task."""
        if report.robot_task_id:
            self._reports[report.robot_task_id] = report

    def clear(self) -> None:
        """Forget all reports: they are those of another robot."""
        self._reports.clear()

    def get(self, task_id: int) -> TaskProc | None:
        """Return the last report on a task; None if there is none."""
        return self._reports.get(task_id)


class TaskGoal:
    """A task.

    Args:
        arg: the command, as the client gave it.
        context: objects shared by all tasks.
        ids: generates an id for a task that has none.
        last_known: last values that the chassis reported.
        last_reports: last reports on tasks, of all clients.
    """

    request_type = full_name(ExecTask)

    def __init__(
        self,
        arg: Any,
        context: Context,
        *,
        ids: TaskIds,
        last_known: LastKnown,
        last_reports: LastReports,
    ) -> None:
        self._arg = arg
        self._context = context
        self._id: int = arg.task_id or ids.next()
        self.name = f"task {self._id}"
        predecessors = context.open_goals.possibly_running(self.name)
        self._previous = last_reports.get(self._id)
        """The last report on an earlier task of this id."""
        self._since = 0
        """Time of the last report that was not on this task, by the robot's clock."""
        last = last_known.value(TaskProc)
        is_current = last is not None and last.robot_task_id == self._id
        if last is not None and is_current:
            self._previous = TaskProc()
            self._previous.CopyFrom(last)
            predecessors = max(predecessors, int(last.state not in OUTCOMES))
        elif last is not None:
            self._since = last.time
        # after an empty report, no more reports on an earlier task come
        is_reused = predecessors > 0 or is_current
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

    def is_displaced(self, message: Message) -> bool:
        return isinstance(message, TaskProc) and message.robot_task_id != self._id

    async def poll(self, found: Callable[[Findings], None]) -> None:
        await poll_tasks(self._context, found, self._read_current, self._read_history)

    def _read_current(self, current: TaskProc) -> Findings | None:
        """Return what the chassis is doing; None if that is not this task."""
        if current.robot_task_id == self._id and current != self._previous:
            return Findings([_report(current)])
        return None

    def _read_history(self, known: Iterable[TaskProc], current: TaskProc) -> Findings:
        """Return the end of this task in the history of the chassis."""
        ended = [old for old in known if self._may_be_end(old)]
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
            and old.state in OUTCOMES
            and old != self._previous
            and old.time >= (self._previous.time if self._previous is not None else 0)
            and (self.attribution.heard or not self._since or old.time > self._since)
        )


def _report(proc: TaskProc) -> Report:
    return Report(proc, OUTCOMES.get(proc.state))
