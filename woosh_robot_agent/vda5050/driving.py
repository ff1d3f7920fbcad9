"""Driving the legs of an order by tasks of the robot."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable

from woosh_robot_agent.link import (
    Answer,
    ChassisClient,
    ConnectionLostError,
    LinkError,
    LinkState,
    NotConnectedError,
    RequestTimeoutError,
)
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, TaskHistory, TaskProc
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.vda5050.background import BackgroundTasks
from woosh_robot_agent.vda5050.leg_task import leg_task
from woosh_robot_agent.vda5050.model.state import Position
from woosh_robot_agent.vda5050.orders.legs import Leg
from woosh_robot_agent.vda5050.task_orders import TaskOrders

_LOG = logging.getLogger(__name__)
_REPORT_AFTER = 3.0
"""Time after which the robot must have reported a task that it executes, in seconds."""
_ASK_EVERY = 1.0
"""Pause between two queries about a task, in seconds."""
_ENDED = {
    task.kCompleted: "",
    task.kCanceled: "the task was cancelled at the robot",
    task.kFailed: "the task failed",
}
"""Reasons why a leg was not driven to its end, by the state of its task; empty if it was."""
UNKNOWN_TASK = "the robot does not know the task"
"""Reason if the robot does not tell how a task ended, e.g. because it was restarted."""


class Driver:
    """Drives one leg at a time by a task of the robot. Used in the event loop of the link.

    A start is never repeated. If the outcome of a task is unknown, the robot is asked.

    Args:
        chassis: the link.
        gate: sends the commands.
        requests: addresses the requests.
        on_end: called when the task has ended, with the reason why it failed; empty if it did not.
        on_unsent: called when a start was not sent, because there is no link.
        on_changed: called when the robot pauses or resumes the task, or when a task of another
            client begins or ends.

    Attributes:
        task_id: id of the current task; 0 without one.
        other_task: id of the task of another client that the robot executes; 0 without one.
        confirmed: True once the robot has reported on the current task over the current link.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        requests: RequestMaker,
        on_end: Callable[[str], None],
        on_unsent: Callable[[], None],
        on_changed: Callable[[], None],
    ) -> None:
        self._chassis = chassis
        self._gate = gate
        self._requests = requests
        self._on_end = on_end
        self._on_unsent = on_unsent
        self._on_changed = on_changed
        self.task_id = 0
        self._last_id = 0
        self.confirmed = False
        self.other_task = 0
        self._orders = TaskOrders(
            chassis, gate, requests, lambda: not self.other_task, self._inquire
        )
        self._inquiry: asyncio.Task[None] | None = None
        """Asks the robot about the current task."""
        self._tasks = BackgroundTasks("vda5050 driving")
        chassis.subscribe(TaskProc, self._reported)
        chassis.on_snapshot(self._snapshot)
        chassis.on_state(self._link_changed)
        chassis.on_robot_changed(self._robot_changed)

    @property
    def paused(self) -> bool:
        """True while the robot pauses the task, by its last report."""
        return self._orders.paused

    @property
    def stands(self) -> bool:
        """True while the robot pauses the task and was not told to go on."""
        return self._orders.stands

    def start(self, leg: Leg, position: Position | None) -> None:
        """Drive a leg.

        Args:
            leg: the leg.
            position: position of the robot; the heading at a node without one follows from it.
        """
        self.execute(leg_task(leg, position))

    def execute(self, request: ExecTask) -> None:
        """Execute a task; it gets a new id."""
        request.task_id = max(self._last_id + 1, int(time.time() * 1000))
        self._set_task(request.task_id)
        self._tasks.start(self._start(request.task_id, request))

    def restore(self, task_id: int, info: RobotInfo) -> None:
        """Follow a task that was started before a restart of the program.

        Args:
            task_id: id of the task; 0 if the start of a leg was not sent.
            info: the first report of the robot.
        """
        self._set_task(task_id)
        if task_id:
            self._snapshot(info)
        else:
            self._on_end("the connector was restarted before it sent the task")

    def cancel(self) -> None:
        """Cancel the task of the leg."""
        self._orders.cancel()

    def pause(self) -> None:
        """Keep the task of the leg paused."""
        self._orders.pause()

    def resume(self) -> None:
        """Resume the task of the leg."""
        self._orders.resume()

    async def close(self) -> None:
        """Stop waiting for answers; the robot goes on with its task."""
        await self._orders.close()
        await self._tasks.close()

    # Commands

    def _set_task(self, task_id: int) -> None:
        self.task_id = task_id
        self._last_id = max(self._last_id, task_id)
        self.confirmed = False
        self._orders.begin(task_id)

    async def _start(self, task_id: int, request: ExecTask) -> None:
        try:
            answer = await self._gate.request(self._requests.address(request))
        except (ConnectionLostError, RequestTimeoutError) as error:
            _LOG.warning("the start of task %d was not answered: %s", task_id, error)
            self._inquire()
        except NotConnectedError:
            if task_id == self.task_id:
                self._set_task(0)
                self._on_unsent()
        except LinkError as error:
            self._end_task(task_id, str(error))
        else:
            if not answer.ok:
                self._end_task(task_id, f"the robot refused the task: {answer.msg}")

    # Reports

    def _reported(self, report: TaskProc) -> None:
        self._note_other(report)
        if not self.task_id:
            return
        if report.robot_task_id == self.task_id:
            self._judge(report)
        elif self.confirmed:  # the last report on our task was lost
            self._inquire()

    def _note_other(self, report: TaskProc) -> None:
        """Take note of a task of another client."""
        is_running = report.robot_task_id and report.state not in _ENDED
        other = report.robot_task_id if is_running else 0
        if other == self.task_id:
            other = 0
        if other != self.other_task:
            self.other_task = other
            self._on_changed()

    def _judge(self, report: TaskProc) -> None:
        """Take a report on the current task."""
        self.confirmed = True
        if report.state in _ENDED:
            reason = _ENDED[report.state]
            self._end(f"{reason}: {report.msg}" if reason and report.msg else reason)
            return
        paused = report.state == task.kPaused and report.action.state == action.kSuspend
        if self._orders.reported(paused):
            self._on_changed()

    def _snapshot(self, info: RobotInfo) -> None:
        """Find out the state of the task after a reconnect."""
        self._note_other(info.task_proc)
        if not self.task_id:
            return
        if info.task_proc.robot_task_id == self.task_id:
            self._judge(info.task_proc)
        else:
            self._inquire()

    def _inquire(self) -> None:
        """Ask the robot about the current task until its state is known."""
        if self.task_id and (self._inquiry is None or self._inquiry.done()):
            self._inquiry = self._tasks.start(self._ask(self.task_id))

    async def _ask(self, task_id: int) -> None:
        clock = asyncio.get_running_loop().time
        deadline = math.inf
        while task_id == self.task_id:
            try:
                await self._chassis.wait_ready(_ASK_EVERY)
                if await self._ask_current(task_id) or await self._ask_history(task_id):
                    return
            except LinkError as error:
                _LOG.debug("no answer about task %d: %s", task_id, error)
                deadline = math.inf
            else:
                if clock() > deadline:
                    self._end_task(task_id, UNKNOWN_TASK)
                    return
                deadline = min(deadline, clock() + _REPORT_AFTER)
            await asyncio.sleep(_ASK_EVERY)

    async def _ask_current(self, task_id: int) -> bool:
        """Return True if the robot executes the task."""

        def found(answer: Answer) -> None:
            if isinstance(answer.body, TaskProc):
                self._note_other(answer.body)
                if answer.body.robot_task_id == task_id == self.task_id:
                    self._judge(answer.body)

        answer = await self._chassis.request(self._requests.empty(TaskProc), tap=found)
        return isinstance(answer.body, TaskProc) and answer.body.robot_task_id == task_id

    async def _ask_history(self, task_id: int) -> bool:
        """Return True if the history of the robot has the end of the task."""

        def end_of(answer: Answer) -> TaskProc | None:
            reports = answer.body.tes if isinstance(answer.body, TaskHistory) else ()
            ended = (each for each in reports if each.state in _ENDED)
            return next((each for each in ended if each.robot_task_id == task_id), None)

        def found(answer: Answer) -> None:
            report = end_of(answer)
            if report is not None and task_id == self.task_id:
                self._judge(report)

        answer = await self._chassis.request(self._requests.empty(TaskHistory), tap=found)
        return end_of(answer) is not None

    def _link_changed(self, state: LinkState) -> None:
        if state is not LinkState.READY:
            self.confirmed = False

    def _robot_changed(self) -> None:
        self.other_task = 0
        self._end("another robot answers now")

    def _end_task(self, task_id: int, reason: str) -> None:
        if task_id == self.task_id:
            self._end(reason)

    def _end(self, reason: str) -> None:
        if self.task_id:
            self._set_task(0)
            self._on_end(reason)
