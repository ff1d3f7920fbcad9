"""Which task and actions move the robot, as the chassis reports, and which of them drive it.

Driving needs the wheels; a lift moves without driving.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection

from woosh_robot_agent.link import (
    Answer,
    ChassisClient,
    ConnectionLostError,
    LinkError,
    LinkState,
    NotConnectedError,
)
from woosh_robot_agent.link.tasks import start_task
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, RobotState, TaskProc
from woosh_robot_agent.pb.ros.action_pb2 import ChargeControl, MoveBase, StepControl
from woosh_robot_agent.pb.ros.ros_pack_pb2 import (
    CallAction,
    Feedbacks,
    kRosErrMsg,
    kRosExecuting,
    kRosPauseFailed,
)
from woosh_robot_agent.pb.util import action_pb2, robot_pb2, task_pb2
from woosh_robot_agent.sentences import Sentence

TASK = Sentence("task {id}")
"""Name of a task."""
TASKS_PER_SET = 100
"""A task of a set is reported as the id of the set times this number, plus its id in the set."""
_UNIX_SECONDS = range(10**9, 2 * 10**9)
"""Ids that are a time in seconds, until 2033; clients give them to single tasks. The id of a set is
such a time or a date, so those of its tasks are higher."""

_HELD_UP = (action_pb2.kRosWarning, action_pb2.kTraffiCtrl)
"""States of an action held up by an obstacle or by traffic control."""
_DRIVING_ACTIONS = {cls.DESCRIPTOR.name for cls in (ChargeControl, MoveBase, StepControl)}
"""Short names of the actions that drive the robot, i.e. use its wheels."""
ACTIONS = {
    field.message_type.full_name: field.message_type.name
    for field in CallAction.DESCRIPTOR.oneofs_by_name["action"].fields
    if field.message_type is not None and "action" in field.message_type.fields_by_name
}
"""Short names of the actions that can be cancelled, by protobuf full name: the members of the oneof
of CallAction whose messages have a field `action`."""
FOLLOW = "Follow"
"""Name of the following of a leader, and of the request that ends it."""
EXECUTING = (kRosExecuting, kRosErrMsg, kRosPauseFailed)
"""States of an action that goes on; kRosErrMsg reports an error on the way, e.g. an obstacle."""

WITH_TASK = (robot_pb2.kTask, robot_pb2.kParking)
"""States of a robot that has accepted a task and not left it yet, also between two of a set."""
_UNFINISHED = (
    task_pb2.kInit,
    task_pb2.kReady,
    task_pb2.kExecuting,
    task_pb2.kPaused,
    task_pb2.kActionWait,
    task_pb2.kTaskWait,
)
"""States of a task that has not ended."""


def is_unfinished(task_proc: TaskProc) -> bool:
    """Return True if a report is about a task that has not ended; it may be paused or waiting."""
    return task_proc.state in _UNFINISHED


def is_held_up(task_proc: TaskProc) -> bool:
    """Return True if a task that is reported as paused only waits, and drives on by itself."""
    return task_proc.state == task_pb2.kPaused and task_proc.action.state in _HELD_UP


class WheelOwner:
    """Tells which task or actions move the robot, by the chassis's reports.

    It does not matter which client started them. Robots report actions only when these change, so
    each new link begins with a query. Until its answer, the actions that were executing when the
    link was lost count as executing.

    Args:
        chassis: the link; used in its event loop only.
        on_start: called when the chassis reports that something has started or been resumed, with
            "task" or the short name of the action, and with True if it drives the robot.

    Attributes:
        name: name of the task or the actions that may drive the robot now; empty without any.
        acceptances: how often the robot has been seen to accept a task while it had none.
        task_id: id of the task that was reported last, also if it has ended; 0 before the first.
    """

    def __init__(self, chassis: ChassisClient, on_start: Callable[[str, bool], None]) -> None:
        self._chassis = chassis
        self._on_start = on_start
        self.name: str = ""
        self.acceptances = 0
        self.task_id = 0
        self._state = 0
        """The last state of the robot."""
        self._task = TaskProc()
        """The last report on a task."""
        self._task_ended = -math.inf
        """Monotonic time at which the end of a task was last reported."""
        self._actions: set[str] = set()
        """Short names of the actions that are being executed."""
        self._reported: set[str] = set()
        """Short names of the actions on which the robot has reported in this link."""
        self._task_callbacks: list[Callable[[TaskProc], None]] = []
        self._action_callbacks: list[Callable[[str, bool], None]] = []
        self._known_callbacks: list[Callable[[Collection[str]], None]] = []
        chassis.on_snapshot(self._snapshot)
        chassis.on_state(self._link_changed)
        chassis.subscribe(RobotState, lambda report: self._state_changed(report.state))
        chassis.subscribe(TaskProc, self._task_changed)
        chassis.subscribe(Feedbacks, self._actions_reported)
        self._link_changed(chassis.state)

    def on_task(self, callback: Callable[[TaskProc], None]) -> None:
        """Call `callback` with each report on the task; an empty one also stands for its end."""
        self._task_callbacks.append(callback)

    def on_action(self, callback: Callable[[str, bool], None]) -> None:
        """Call `callback` with each report on an action: its short name, and True if it goes on."""
        self._action_callbacks.append(callback)

    def on_known(self, callback: Callable[[Collection[str]], None]) -> None:
        """Call `callback` once in each link, when the query of the actions has ended.

        If the robot did not tell what it executes, the actions that were executing when the link
        was lost count as ended, and the callback gets their short names.
        """
        self._known_callbacks.append(callback)

    def moves(self, what: str) -> bool:
        """Return True if something may move the robot: it is active, and may drive on by itself.

        Args:
            what: "task", `FOLLOW`, or an action by its short name.
        """
        return may_drive(self._task) if what == "task" else self.is_active(what)

    def is_active(self, what: str) -> bool:
        """Return True if something has begun and not ended."""
        if what == FOLLOW:
            return self._state == robot_pb2.kFollowing
        return is_unfinished(self._task) if what == "task" else what in self._actions

    @property
    def awaits_task(self) -> bool:
        """True if the robot has accepted a task, and has not reported that it has begun."""
        return self._state in WITH_TASK and not is_unfinished(self._task)

    def current_set(self, within: float = 0.0) -> int:
        """Return the id of the set whose task goes on, or has ended at most `within` seconds ago.

        Returns:
            0 if there is no such task, or if its id is that of a single task.
        """
        is_current = is_unfinished(self._task) or time.monotonic() < self._task_ended + within
        is_single = self.task_id in _UNIX_SECONDS
        return self.task_id // TASKS_PER_SET if is_current and not is_single else 0

    def task_ended(self, task_id: int) -> None:
        """Note the end of a task that the chassis has told in an answer, but not in a report."""
        if self._task.robot_task_id == task_id > 0:
            self._task_changed(TaskProc())

    def action_ended(self, name: str) -> None:
        """Note the end of an action, by its short name, that only an answer has told."""
        self._set_action(name, goes_on=False)

    def _snapshot(self, info: RobotInfo) -> None:
        self._state_changed(info.state)
        self._task_changed(info.task_proc)

    def _state_changed(self, state: int) -> None:
        before, self._state = self._state, state
        self.acceptances += state in WITH_TASK and before not in WITH_TASK

    def _task_changed(self, report: TaskProc) -> None:
        """Note the state of the task; call `on_start` if it drives and did not before."""
        before, self._task = self._task, report
        self.task_id = report.robot_task_id or self.task_id  # after the end, it has no id
        if is_unfinished(before) and not is_unfinished(report):
            self._task_ended = time.monotonic()
        self._update_name()
        drove_before = may_drive(before) and before.robot_task_id == report.robot_task_id
        if may_drive(report) and not drove_before:
            self._on_start("task", True)
        for callback in self._task_callbacks:
            callback(report)

    def _actions_reported(self, reports: Feedbacks) -> None:
        """Note which actions are being executed; call `on_start` for those that begin."""
        for report in reports.fbs:
            name = ACTIONS.get(report.action)
            if name is None:
                continue
            goes_on = report.state in EXECUTING
            begins = goes_on and name not in self._actions
            if begins and report.state != kRosExecuting:
                continue  # a robot may report the other states after the end of the action
            self._reported.add(name)
            if begins:
                self._on_start(name, name in _DRIVING_ACTIONS)
            self._set_action(name, goes_on=goes_on)

    def _set_action(self, name: str, *, goes_on: bool) -> None:
        if goes_on:
            self._actions.add(name)
        else:
            self._actions.discard(name)
        self._update_name()
        for callback in self._action_callbacks:
            callback(name, goes_on)

    def _link_changed(self, state: LinkState) -> None:
        if state is LinkState.READY:  # the RobotInfo of the handshake does not have the actions
            start_task(self._ask_actions(), "query of the actions")
        else:
            self._reported.clear()

    async def _ask_actions(self) -> None:
        """Ask which actions the robot executes; without an answer, none counts as executing."""
        try:
            # `first`: it does not count towards the `max_in_flight` of the clients' requests
            await self._chassis.request(Feedbacks(), first=True, tap=self._answered)
        except (ConnectionLostError, NotConnectedError):
            pass  # the next link begins with a query, too
        except LinkError:
            self._note_known(None)

    def _answered(self, answer: Answer) -> None:
        """Take the actions from the answer to the query."""
        self._note_known(answer.body if isinstance(answer.body, Feedbacks) and answer.ok else None)

    def _note_known(self, answer: Feedbacks | None) -> None:
        """Take the actions from the answer in a new link; None if the robot does not tell them.

        An action that was reported in this link is not taken: its report is newer than the answer.
        """
        before = self._actions - self._reported
        fbs = answer.fbs if answer is not None else ()
        states = {ACTIONS[each.action]: each.state for each in fbs if each.action in ACTIONS}
        for name in (before | states.keys()) - self._reported:
            goes_on = states.get(name) in EXECUTING
            if goes_on:  # also an action of the link before, which may have been started again
                self._on_start(name, name in _DRIVING_ACTIONS)
            self._set_action(name, goes_on=goes_on)
        for callback in self._known_callbacks:
            callback(before if answer is None else ())

    def _update_name(self) -> None:
        """Set `name` by the last reports."""
        if may_drive(self._task):
            self.name = TASK(id=self._task.robot_task_id)
        else:
            self.name = ", ".join(sorted(self._actions & _DRIVING_ACTIONS))


def may_drive(task: TaskProc) -> bool:
    """Return True if a task drives, or may drive on without an order; a paused task may not."""
    return is_unfinished(task) and (task.state != task_pb2.kPaused or is_held_up(task))
