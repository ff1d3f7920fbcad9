"""Goals of robot/ExecTask and robot/ExecPreTask: single tasks, and task sets.

The chassis reports on each task of a set with woosh.robot.TaskProc, as on any task, but not on the
set itself. After the end of a task, it either leaves the set, or begins the next task within about
a second. Until then, its state is still that of a robot with a task.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link import Answer
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.reports import RecentDict
from woosh_robot_agent.motion.wheel_owner import is_unfinished
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecPreTask, ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import RobotState, TaskHistory, TaskProc
from woosh_robot_agent.pb.util import action_pb2, robot_pb2, task_pb2
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.robot.who_drives import TASKS_PER_SET
from woosh_robot_agent.ros.actions.goal import (
    Attribution,
    Findings,
    Outcome,
    Report,
    Start,
)
from woosh_robot_agent.ros.actions.run import Context


async def poll_tasks(
    context: Context,
    found: Callable[[Findings], None],
    read_current: Callable[[TaskProc], Findings | None],
    read_history: Callable[[Iterable[TaskProc], TaskProc], Findings],
) -> None:
    """Request the current task, and also the ended tasks if the current one is not of the goal.

    Args:
        context: objects shared by all tasks.
        found: called with the findings as soon as an answer is read.
        read_current: reads the report on the current task; returns None if the task is not of the
            goal.
        read_history: called with the last reports on ended tasks and the report on the current
            task.

    Raises:
        LinkError: the chassis did not answer.
    """

    def tap_current(answer: Answer) -> None:
        current = answer.body
        if not answer.ok or not isinstance(current, TaskProc):
            found(Findings())
        elif (findings := read_current(current)) is not None:
            found(findings)

    answer = await context.chassis.request(context.empty(TaskProc), tap=tap_current)
    task = answer.body
    if not answer.ok or not isinstance(task, TaskProc) or read_current(task) is not None:
        return

    def tap_history(answer: Answer, current: TaskProc = task) -> None:
        known = answer.body.tes if answer.ok and isinstance(answer.body, TaskHistory) else ()
        found(read_history(known, current))

    await context.chassis.request(context.empty(TaskHistory), tap=tap_history)


_EXECUTING = (robot_pb2.kTask, robot_pb2.kParking)
"""States of a robot that executes a task, or is about to begin the next one of a set."""


class TaskSetGoal:
    """A predefined task set.

    Args:
        arg: the command, as the client gave it.
        context: objects shared by all tasks.
        last_known: last values that the chassis reported.
    """

    request_type = full_name(ExecPreTask)

    def __init__(self, arg: Any, context: Context, *, last_known: LastKnown) -> None:
        self._arg = arg
        self._context = context
        self._last_known = last_known
        self._id: int = arg.task_set_id
        self.name = f"task set {self._id}"
        self._last = TaskProc()
        """The last report on a task of the set; blank before the first one."""
        self._polls_outside = 0
        """Number of polls since `_last` that found the robot executing nothing of the set."""
        last = last_known.value(TaskProc) or TaskProc()
        self._since = last.time
        """Time of the last report before this goal, by the robot's clock."""
        predecessors = context.open_goals.possibly_running(self.name)
        self.attribution = Attribution(max(predecessors, int(self._is_executing(last))))

    def request(self) -> Start:
        return Start(self._context.to_proto(self._arg))

    def cancel_request(self) -> Message:
        return ActionOrder(order=action_pb2.kCancel)

    def read(self, message: Message) -> Iterable[Report]:
        if not isinstance(message, TaskProc) or not self._is_of_set(message):
            return []
        before, self._last = self._last, message
        self._polls_outside = 0
        # whether the end of a task is the end of the set is known only after a poll
        begins = before.state in OUTCOMES and self._is_executing(message)
        return [Report(message, None, begins_part=begins)]

    def is_displaced(self, message: Message) -> bool:
        if isinstance(message, RobotState):
            return message.state not in _EXECUTING
        return isinstance(message, TaskProc) and not self._is_executing(message)

    async def poll(self, found: Callable[[Findings], None]) -> None:
        await poll_tasks(self._context, found, self._read_current, self._read_history)

    def _read_current(self, current: TaskProc) -> Findings | None:
        """Return the report on the current task; None if the robot executes nothing of the set."""
        if self._is_executing(current):
            return Findings(tuple(self.read(current)))
        state = self._last_known.value(RobotState)
        if not is_unfinished(current) and state is not None and state.state in _EXECUTING:
            # between two tasks of the set
            return Findings([Report(self._last, None)] if self.attribution.heard else ())
        return None

    def _read_history(self, known: Iterable[TaskProc], _current: TaskProc) -> Findings:
        """Return the end of the set, if the chassis has left it for good."""
        self._polls_outside += 1
        end = self._end(old for old in known if self._is_of_set(old) and old.state in OUTCOMES)
        # a single poll can fall between two tasks
        if end is not None and self._polls_outside > 1:
            return Findings([Report(end, OUTCOMES[end.state])])
        return Findings(unknown="the chassis does not execute the task set any more")

    def _end(self, ended: Iterable[TaskProc]) -> TaskProc | None:
        """Return the report on the last task of the set, from the chassis's ended tasks."""
        last = self._last
        if not self.attribution.heard:
            candidates = [old for old in ended if old.time > self._since]
        elif last.state in OUTCOMES:
            candidates = [last, *(old for old in ended if old.time > last.time)]
        else:
            candidates = [old for old in ended if old.time >= last.time]
        return max(candidates, key=lambda report: report.time, default=None)

    def failure(self, reason: str) -> Message:
        return TaskProc(
            robot_task_id=self._last.robot_task_id,
            type=self._last.type,
            state=task_pb2.kFailed,
            msg=reason,
            time=int(time.time()),
        )

    def _is_of_set(self, report: TaskProc) -> bool:
        return bool(self._id) and report.robot_task_id // TASKS_PER_SET == self._id

    def _is_executing(self, report: TaskProc) -> bool:
        """Return True if a report says that a task of the set is running."""
        return self._is_of_set(report) and report.state not in OUTCOMES


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
        """Return an id above all earlier ids."""
        self._last = max(self._last + 1, int(time.time()))
        return self._last


class LastReports:
    """The last report on each of the latest tasks.

    The last known TaskProc is not enough: after the end of a task, the chassis sends an empty
    TaskProc.
    """

    def __init__(self) -> None:
        self._reports: RecentDict[int, TaskProc] = RecentDict(_MAX_REPORTS)
        """Reports by task id."""

    def add(self, report: TaskProc) -> None:
        """Remember a report, unless it is empty."""
        if report.robot_task_id:
            self._reports[report.robot_task_id] = report

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
        self._type: Any = getattr(arg.type, "value", arg.type)  # in ROS, an enum is a message
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
        """Return the report on the current task; None if it is another task."""
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
            type=self._type,
            state=task_pb2.kFailed,
            msg=reason,
            time=int(time.time()),
        )

    def _may_be_end(self, old: TaskProc) -> bool:
        """Return True if a history entry can be the end of this task, not of an earlier task."""
        return (
            old.robot_task_id == self._id
            and old.state in OUTCOMES
            and old != self._previous
            and old.time >= (self._previous.time if self._previous is not None else 0)
            and (self.attribution.heard or not self._since or old.time > self._since)
        )


def _report(proc: TaskProc) -> Report:
    return Report(proc, OUTCOMES.get(proc.state))
