"""Goals of robot/ExecTask and robot/ExecPreTask: single tasks, and task sets.

The chassis reports on each task of a set with woosh.robot.TaskProc, as on any task, but not on the
set itself. After the end of a task, it either leaves the set, or begins the next task within about
a second. Until then, its state is still that of a robot with a task.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link import Answer
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.motion.wheel_owner import TASKS_PER_SET, WITH_TASK, is_unfinished
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecPreTask, ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import RobotState, TaskHistory, TaskProc
from woosh_robot_agent.pb.util import action_pb2, robot_pb2, task_pb2
from woosh_robot_agent.ros.actions.goal import (
    Attribution,
    Cause,
    End,
    Outcome,
    PollResult,
    Report,
)
from woosh_robot_agent.ros.actions.run import GoalContext


def _note_polled_end(context: GoalContext, task_id: int, end: End) -> None:
    """Tell the gate that a task has ended.

    If no report tells the end, only the state of the robot shows that the task does not go on.
    """
    state = context.last_known.value(RobotState)
    if end.cause is not Cause.AGENT or (state is not None and state.state == robot_pb2.kIdle):
        context.gate.wheel_owner.task_ended(task_id)


OUTCOMES = {
    task_pb2.kCompleted: Outcome.SUCCEEDED,
    task_pb2.kFailed: Outcome.ABORTED,
    task_pb2.kCanceled: Outcome.CANCELED,
}
"""Outcome by the state of a task. A task in any other state has not ended."""
_MAX_TIME = 2**31 - 1
"""Latest Unix time that a TaskProc can hold, in seconds: in January 2038."""


class _TasksGoal(ABC):
    """The goal to execute one task or several.

    Args:
        arg: the command, as the client gave it.
    """

    def __init__(self, arg: Any, context: GoalContext) -> None:
        self._arg = arg
        self._context = context

    def cancel_request(self) -> Message:
        return ActionOrder(order=action_pb2.kCancel)

    async def poll(self, on_result: Callable[[PollResult], None]) -> None:
        """Request the current task, and also the ended tasks if the current one is not its own."""

        def current_received(answer: Answer) -> None:
            current = answer.body
            if not answer.ok or not isinstance(current, TaskProc):
                on_result(PollResult())
                return
            if not answer.is_outdated:
                self._context.last_known.remember(current)  # a push may have been lost
            if self._is_own(current):
                on_result(self._read_current(current))

        chassis, empty = self._context.chassis, self._context.requests.empty
        answer = await chassis.request(empty(TaskProc), tap=current_received)
        task = answer.body
        # `current_received` may still be queued behind pushes, so this is also decided here
        if not answer.ok or not isinstance(task, TaskProc) or self._is_own(task):
            return

        # `current` is a parameter for mypy, which knows that `task` is a TaskProc only out here
        def history_received(answer: Answer, current: TaskProc = task) -> None:
            ended = answer.body.tes if answer.ok and isinstance(answer.body, TaskHistory) else ()
            # an end later than the current report is from before the robot's clock was set back
            latest = current.time or math.inf
            on_result(self._read_history([old for old in ended if old.time <= latest], current))

        await chassis.request(empty(TaskHistory), tap=history_received)

    @abstractmethod
    def _is_own(self, current: TaskProc) -> bool:
        """Return True if the current task is of this goal."""

    @abstractmethod
    def _read_current(self, current: TaskProc) -> PollResult:
        """Read the report on the current task, which is of this goal."""

    @abstractmethod
    def _read_history(self, ended: Iterable[TaskProc], current: TaskProc) -> PollResult:
        """Read the last reports on ended tasks; the report on the current task is not later."""


class TaskSetGoal(_TasksGoal):
    """The goal to execute a predefined task set."""

    request_type = full_name(ExecPreTask)

    def __init__(self, arg: Any, context: GoalContext) -> None:
        super().__init__(arg, context)
        self._id: int = arg.task_set_id
        self.name = f"task set {self._id}"
        self._last = TaskProc()
        """The last report on a task of the set; blank before the first one."""
        self._polls_outside = 0
        """Number of polls since `_last` that found the robot executing nothing of the set."""
        last = context.last_known.value(TaskProc) or TaskProc()
        self._since = last.time
        """Unix time of the last report before this goal, by the robot's clock, in seconds; 0 if
        there is none."""
        predecessors = context.open_goals.possibly_running(self.name)
        # reports may belong to an earlier run of the set, of another goal or of another program
        self.attribution = Attribution(max(predecessors, int(self._is_executing(last))))

    def request(self) -> Message:
        return self._context.to_proto(self._arg)

    def read(self, message: Message) -> Iterable[Report]:
        if not isinstance(message, TaskProc) or not self._is_of_set(message):
            return []
        before, self._last = self._last, message
        self._polls_outside = 0
        is_other_task = before.robot_task_id not in (0, message.robot_task_id)  # 0: no task before
        is_next_task = before.state in OUTCOMES or is_other_task
        # whether the end of a task is the end of the set is known only after a poll
        return [Report(message, None, begins_part=is_next_task and self._is_executing(message))]

    def is_displaced(self, message: Message) -> bool:
        if isinstance(message, RobotState):
            return message.state not in WITH_TASK
        return isinstance(message, TaskProc) and not self._is_executing(message)

    def _is_own(self, current: TaskProc) -> bool:
        """Return True if the robot executes a task of the set, or may be between two of them."""
        if self._is_executing(current):
            return True
        state = self._context.last_known.value(RobotState)
        return not is_unfinished(current) and state is not None and state.state in WITH_TASK

    def _read_current(self, current: TaskProc) -> PollResult:
        """Return the report on the current task of the set.

        Between two tasks, return the last report again; before the first one, no report.
        """
        if self._is_executing(current):
            return PollResult(tuple(self.read(current)))
        return PollResult([Report(self._last, None)] if self.attribution.has_report else ())

    def _read_history(self, ended: Iterable[TaskProc], _current: TaskProc) -> PollResult:
        """Return the end of the set, if the chassis has left it for good."""
        self._polls_outside += 1
        end = self._end(old for old in ended if self._is_of_set(old) and old.state in OUTCOMES)
        # a single poll can fall between two tasks
        if end is not None and self._polls_outside > 1:
            return PollResult([Report(end, OUTCOMES[end.state])])
        return PollResult(unknown="the chassis does not execute the task set any more")

    def _end(self, ended: Iterable[TaskProc]) -> TaskProc | None:
        """Return the report on the last of the tasks that ended in this goal; None without one.

        Args:
            ended: the reports on all ended tasks of the set, even from before this goal.
        """
        last = self._last
        if not self.attribution.has_report:
            candidates = [old for old in ended if 0 < self._since < old.time]
        elif last.state in OUTCOMES:
            candidates = [last, *(old for old in ended if old.time > last.time)]
        else:
            candidates = [old for old in ended if old.time >= last.time]
        return max(candidates, key=lambda report: report.time, default=None)

    def note_polled_end(self, end: End) -> None:
        _note_polled_end(self._context, self._last.robot_task_id, end)

    def failure(self, reason: str) -> Message:
        return _failure(self._last.robot_task_id, self._last.type, reason)

    def _is_of_set(self, report: TaskProc) -> bool:
        return bool(self._id) and report.robot_task_id // TASKS_PER_SET == self._id

    def _is_executing(self, report: TaskProc) -> bool:
        """Return True if a report says that a task of the set is running."""
        return self._is_of_set(report) and report.state not in OUTCOMES


def unused_task_ids() -> Iterator[int]:
    """Yield rising task ids: Unix time in seconds, as other clients use it."""
    last = 0
    while True:
        last = max(last + 1, int(time.time()))
        yield last


class TaskGoal(_TasksGoal):
    """The goal to execute a single task.

    Args:
        unused_ids: yields an id for a task that has none.
        last_reports: last report on each of the latest tasks, by task id. The last known TaskProc
            is not enough: after the end of a task, the chassis sends an empty TaskProc.
    """

    request_type = full_name(ExecTask)

    def __init__(
        self,
        arg: Any,
        context: GoalContext,
        *,
        unused_ids: Iterator[int],
        last_reports: Mapping[int, TaskProc],
    ) -> None:
        super().__init__(arg, context)
        self._type: Any = getattr(arg.type, "value", arg.type)  # in ROS, an enum is a message
        self._id: int = arg.task_id or next(unused_ids)
        self.name = f"task {self._id}"
        predecessors = context.open_goals.possibly_running(self.name)
        self._previous = last_reports.get(self._id)
        """The last report on a task of this id before this goal; None without one."""
        self._since = 0
        """Unix time of the last TaskProc before this goal, by the robot's clock, in seconds; 0 if
        there is none, or if it was on a task of this id."""
        last = context.last_known.value(TaskProc) or TaskProc()
        is_current = last.robot_task_id == self._id
        if is_current:
            self._previous = last
            # another program may have started the task that is running
            predecessors = max(predecessors, int(last.state not in OUTCOMES))
        else:
            self._since = last.time
        # once the chassis has left an earlier task of this id, it sends no more reports on it
        may_be_reported = predecessors > 0 or is_current
        self.attribution = Attribution(predecessors, tuple(Outcome) if may_be_reported else ())

    def request(self) -> Message:
        request: Any = self._context.to_proto(self._arg)
        request.task_id = self._id
        return request  # type: ignore[no-any-return]

    def read(self, message: Message) -> Iterable[Report]:
        if isinstance(message, TaskProc) and message.robot_task_id == self._id:
            return [_report(message)]
        return []

    def is_displaced(self, message: Message) -> bool:
        return isinstance(message, TaskProc) and message.robot_task_id != self._id

    def _is_own(self, current: TaskProc) -> bool:
        """Return True if the current task is this task.

        A report that has not changed since before this goal is on an earlier task of the same id.
        """
        return current.robot_task_id == self._id and current != self._previous

    @staticmethod
    def _read_current(current: TaskProc) -> PollResult:
        return PollResult([_report(current)])

    def _read_history(self, ended: Iterable[TaskProc], current: TaskProc) -> PollResult:
        """Return the end of this task in the history, or that the chassis does not know it."""
        ends = [old for old in ended if self._may_be_end(old, current)]
        if ends:
            return PollResult([_report(max(ends, key=lambda old: old.time))])
        doing = f"task {current.robot_task_id}" if current.robot_task_id else "no task"
        return PollResult(
            unknown=f"the chassis does not know the task any more; it is executing {doing}"
        )

    def note_polled_end(self, end: End) -> None:
        _note_polled_end(self._context, self._id, end)

    def failure(self, reason: str) -> Message:
        return _failure(self._id, self._type, reason)

    def _may_be_end(self, old: TaskProc, current: TaskProc) -> bool:
        """Return True if a history entry can be the end of this task, not of an earlier task.

        Args:
            current: the report on the current task, which is not this task.
        """
        if old.robot_task_id != self._id or old.state not in OUTCOMES:
            return False
        previous_time = 0 if self._previous is None else self._previous.time
        if old == self._previous:
            return False
        has_report = self.attribution.has_report
        # an entry that is earlier than `_previous` is new if the robot's clock was set back
        if old.time < previous_time and not (has_report and 0 < current.time < previous_time):
            return False
        if has_report:
            return True
        if self._since:  # without a report on this goal, only the time tells
            return old.time > self._since
        # The last use of the id must be known, or the agent must have chosen the id: otherwise this
        # may be the end of a task with this id from before the agent was connected.
        return self._previous is not None or not self._arg.task_id


def _report(message: TaskProc) -> Report:
    return Report(message, OUTCOMES.get(message.state))


def _failure(task_id: int, kind: Any, reason: str) -> TaskProc:
    """Return a report that a task of the type `kind` has failed."""
    return TaskProc(
        robot_task_id=task_id,
        type=kind,
        state=task_pb2.kFailed,
        msg=reason,
        time=min(int(time.time()), _MAX_TIME),
    )
