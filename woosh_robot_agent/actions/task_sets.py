"""Goals of robot/ExecPreTask: predefined task sets, whose tasks the chassis executes in turn.

The chassis reports on each task of the set with woosh.robot.TaskProc, as on any task, but not on
the set itself. After the end of a task it either begins the next one within about a second, and its
state is that of a robot with a task until then, or it leaves the set.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.actions.attribution import Attribution
from woosh_robot_agent.actions.context import Context
from woosh_robot_agent.actions.kind import Findings, Report, Start
from woosh_robot_agent.actions.task_polls import poll_tasks
from woosh_robot_agent.actions.tasks import OUTCOMES
from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecPreTask
from woosh_robot_agent.pb.robot.robot_pb2 import RobotState, TaskProc
from woosh_robot_agent.pb.util import action_pb2, robot_pb2, task_pb2
from woosh_robot_agent.protos import full_name
from woosh_robot_agent.readiness import is_running

TASKS_PER_SET = 100
"""A task of a set is reported as the id of the set times this number, plus its id in the set."""
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
        """Number of polls since then that found the robot executing nothing of the set."""
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
        # the end of a task may be the end of the set: only a poll tells
        begins = before.state in OUTCOMES and self._is_executing(message)
        return [Report(message, None, begins_part=begins)]

    def is_displaced(self, message: Message) -> bool:
        if isinstance(message, RobotState):
            return message.state not in _EXECUTING
        return isinstance(message, TaskProc) and not self._is_executing(message)

    async def poll(self, found: Callable[[Findings], None]) -> None:
        await poll_tasks(self._context, found, self._read_current, self._read_history)

    def _read_current(self, current: TaskProc) -> Findings | None:
        """Return what the chassis is doing; None if that is nothing of the set."""
        if self._is_executing(current):
            return Findings(tuple(self.read(current)))
        state = self._last_known.value(RobotState)
        if not is_running(current) and state is not None and state.state in _EXECUTING:
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
        """Return the report on the last task of the set, given all ends that the chassis knows."""
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
