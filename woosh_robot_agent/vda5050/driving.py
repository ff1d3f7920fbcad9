"""Driving the legs of an order by tasks of the robot."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Coroutine
from typing import Any

from woosh_robot_agent.link import (
    Answer,
    ChassisClient,
    ConnectionLostError,
    LinkError,
    LinkState,
    RequestTimeoutError,
)
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, TaskHistory, TaskProc
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.vda5050.leg_task import leg_task
from woosh_robot_agent.vda5050.model.state import Position
from woosh_robot_agent.vda5050.orders.legs import Leg

_LOG = logging.getLogger(__name__)
_SOURCE = "vda5050"
"""Name of the sender at the motion gate."""
_ENDED = {
    task.kCompleted: "",
    task.kCanceled: "the task was cancelled at the robot",
    task.kFailed: "the task failed",
}
"""Reasons why a leg was not driven to its end, by the state of its task; empty if it was."""


class Driver:
    """Drives one leg at a time by a task of the robot. Used in the event loop of the link.

    No start is repeated. If its answer is lost, the reports of the robot decide whether the task
    runs.

    Args:
        chassis: the link.
        gate: sends the commands.
        requests: addresses the requests.
        on_end: called when the robot does not drive the leg any more, with the reason why it did
            not reach the goal; empty if it did.
        on_changed: called when the robot pauses or resumes the task.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        requests: RequestMaker,
        on_end: Callable[[str], None],
        on_changed: Callable[[], None],
    ) -> None:
        self._chassis = chassis
        self._gate = gate
        self._requests = requests
        self._on_end = on_end
        self._on_changed = on_changed
        self._task_id = 0
        """Id of the current task; 0 without one."""
        self._last_id = 0
        self._is_reported = False
        """True once the robot has reported on the current task."""
        self.paused = False
        """True while the robot pauses the task."""
        self._tasks: set[asyncio.Task[None]] = set()
        chassis.subscribe(TaskProc, self._reported)
        chassis.on_snapshot(self._snapshot)
        chassis.on_robot_changed(lambda: self._end("another robot answers now"))

    def start(self, leg: Leg, position: Position | None) -> None:
        """Drive a leg.

        Args:
            leg: the leg.
            position: position of the robot; the heading at a node without one follows from it.
        """
        self.execute(leg_task(0, leg, position))

    def execute(self, request: ExecTask) -> None:
        """Execute a task; it gets a new id."""
        self._task_id = self._last_id = max(self._last_id + 1, int(time.time() * 1000))
        self._is_reported = self.paused = False
        request.task_id = self._task_id
        self._spawn(self._start(self._task_id, request))

    def cancel(self) -> None:
        """Cancel the task of the leg."""
        if self._task_id:
            self._spawn(self._order(self._task_id, action.kCancel))

    def pause(self) -> None:
        """Pause the task of the leg."""
        if self._task_id:
            self._spawn(self._order(self._task_id, action.kPause))

    def resume(self) -> None:
        """Resume the task of the leg."""
        if self._task_id:
            self._spawn(self._order(self._task_id, action.kContinue))

    async def close(self) -> None:
        """Stop waiting for answers; the robot goes on with its task."""
        for each in self._tasks:
            each.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        running = asyncio.get_running_loop().create_task(work, name="vda5050 driving")
        self._tasks.add(running)
        running.add_done_callback(self._tasks.discard)

    async def _start(self, task_id: int, request: ExecTask) -> None:
        try:
            answer = await self._gate.request(self._requests.address(request), source=_SOURCE)
        except (ConnectionLostError, RequestTimeoutError) as error:
            _LOG.warning("the start of task %d was not answered: %s", task_id, error)
            if self._chassis.state is LinkState.READY:
                await self._find_end(task_id)
        except LinkError as error:
            self._end_task(task_id, str(error))
        else:
            if not answer.ok:
                self._end_task(task_id, f"the robot refused the task: {answer.msg}")

    async def _order(self, task_id: int, order: action.Order) -> None:
        request = ActionOrder(order=order)
        try:
            answer = await self._gate.request(self._requests.address(request), source=_SOURCE)
        except LinkError as error:
            _LOG.warning("an order to task %d was not sent or not answered: %s", task_id, error)
            return
        if not answer.ok and task_id == self._task_id:
            _LOG.warning("the robot refused an order to task %d: %s", task_id, answer.msg)
            await self._find_end(task_id)

    def _reported(self, report: TaskProc) -> None:
        if not self._task_id:
            return
        if report.robot_task_id == self._task_id:
            self._is_reported = True
            self._judge(report)
        elif self._is_reported:  # the last report on our task was lost
            self._spawn(self._find_end(self._task_id))

    def _judge(self, report: TaskProc) -> None:
        """Take a report on the current task."""
        if report.state in _ENDED:
            reason = _ENDED[report.state]
            self._end(f"{reason}: {report.msg}" if reason and report.msg else reason)
            return
        paused = report.state == task.kPaused and report.action.state == action.kSuspend
        if paused != self.paused:
            self.paused = paused
            self._on_changed()

    def _snapshot(self, info: RobotInfo) -> None:
        """Find out what became of the task while there was no link."""
        if not self._task_id:
            return
        if info.task_proc.robot_task_id == self._task_id:
            self._is_reported = True
            self._judge(info.task_proc)
        else:
            self._spawn(self._find_end(self._task_id))

    async def _find_end(self, task_id: int) -> None:
        """Look up the end of a task in the history of the robot."""

        def found(answer: Answer) -> None:
            if task_id != self._task_id or not isinstance(answer.body, TaskHistory):
                return
            for report in answer.body.tes:
                if report.robot_task_id == task_id and report.state in _ENDED:
                    self._judge(report)
                    return
            self._end_task(task_id, "the robot does not know the task any more")

        try:
            await self._chassis.request(self._requests.empty(TaskHistory), tap=found)
        except LinkError as error:
            _LOG.debug("history of task %d: %s", task_id, error)  # asked again after a reconnect

    def _end_task(self, task_id: int, reason: str) -> None:
        if task_id == self._task_id:
            self._end(reason)

    def _end(self, reason: str) -> None:
        if self._task_id:
            self._task_id = 0
            self.paused = False
            self._on_end(reason)
