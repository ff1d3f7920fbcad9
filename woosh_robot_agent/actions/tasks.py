"""Goals of robot/ExecTask: tasks that the chassis reports on by woosh.robot.TaskProc."""

from __future__ import annotations

import time
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.actions.events import End, Report
from woosh_robot_agent.actions.run import Context, GoalRun
from woosh_robot_agent.actions.server import Goal, Outcome
from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import TaskHistory, TaskProc
from woosh_robot_agent.pb.util import action_pb2, task_pb2
from woosh_robot_agent.protos import full_name

_OUTCOMES = {
    task_pb2.kCompleted: Outcome.SUCCEEDED,
    task_pb2.kFailed: Outcome.ABORTED,
    task_pb2.kCanceled: Outcome.CANCELED,
}


class FreshIds:
    """Task ids that were not used before: the time in s, as clients out there choose them."""

    def __init__(self) -> None:
        self._last = 0

    def next(self) -> int:
        """An id that is above all before it."""
        self._last = max(self._last + 1, int(time.time()))
        return self._last


class TaskRun(GoalRun):
    """One task.

    Args:
        ids: gives an id to a task that has none.
        known: what the chassis last said.
    """

    def __init__(self, goal: Goal, context: Context, *, ids: FreshIds, known: LastKnown) -> None:
        super().__init__(goal, context)
        self._task = ExecTask(task_id=self.goal.arg.task_id, type=self.goal.arg.type.value)
        if not self._task.task_id:
            self._task.task_id = ids.next()
        self._last: TaskProc | None = None
        last = known.get(full_name(TaskProc))
        self._before: TaskProc | None = None
        """The last report on an earlier task of this id."""
        if isinstance(last, TaskProc) and last.robot_task_id == self.task_id:
            self._before = TaskProc()
            self._before.CopyFrom(last)
            self.inherited = tuple(_OUTCOMES.values())
            self.predecessors = int(last.state not in _OUTCOMES)
        same = [r for r in self.runs.open if isinstance(r, TaskRun) and r.task_id == self.task_id]
        if same:
            self.inherited = tuple(_OUTCOMES.values())
            self.predecessors = max(self.predecessors, len(same))

    @property
    def task_id(self) -> int:
        """The id by which the chassis reports on the task."""
        return self._task.task_id

    def make_request(self) -> Message:
        """See `GoalRun.make_request`."""
        request: Any = self.to_proto(self.goal.arg)
        request.task_id = self.task_id
        return request  # type: ignore[no-any-return]

    def make_cancel(self) -> Message:
        """See `GoalRun.make_cancel`."""
        return ActionOrder(order=action_pb2.kCancel)

    def failed(self, reason: str) -> Message:
        """See `GoalRun.failed`."""
        return TaskProc(
            robot_task_id=self.task_id,
            type=self._task.type,
            state=task_pb2.kFailed,
            msg=reason,
            time=int(time.time()),
        )

    def read(self, report: Message) -> End | None:
        """See `GoalRun.read`."""
        if not isinstance(report, TaskProc) or report.robot_task_id != self.task_id:
            return None
        outcome = _OUTCOMES.get(report.state)
        if not self.is_mine(outcome):
            return None
        self._last = report
        self.heard()
        self.goal.feedback(self.to_ros(report))
        return None if outcome is None else End(outcome, report)

    async def recover(self) -> End | None:
        """See `GoalRun.recover`."""
        answer = await self.chassis.request(self.query(TaskProc))
        proc = answer.body
        if not answer.ok or not isinstance(proc, TaskProc):
            return None
        if proc.robot_task_id == self.task_id and proc != self._before:
            if proc == self._last:  # told already
                self.heard()
            else:
                self.post(Report(proc))
            return None
        answer = await self.chassis.request(self.query(TaskHistory))
        if not answer.ok or not isinstance(answer.body, TaskHistory):
            return None
        oldest = self._before.time if self._before is not None else 0
        ended = [
            old
            for old in answer.body.tes
            if old.robot_task_id == self.task_id
            and old.state in _OUTCOMES
            and old != self._before
            and old.time >= oldest
        ]
        if ended:
            self.post(Report(max(ended, key=lambda old: old.time)))
            return None
        return self.aborted(f"the chassis does not know the task any more; it is at {_shown(proc)}")


def _shown(proc: TaskProc) -> str:
    return f"task {proc.robot_task_id}" if proc.robot_task_id else "no task"
