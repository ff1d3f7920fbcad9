"""Pause, resumption and cancellation of the task that the robot executes."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
from collections.abc import Callable

from woosh_robot_agent.link import ChassisClient, LinkError, LinkState
from woosh_robot_agent.link.errors import NotConnectedError, TooManyRequestsError
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.link.timeouts import run_with_timeout
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.vda5050.background import BackgroundTasks

_LOG = logging.getLogger(__name__)
_REPEAT_AFTER = 3.0
"""Time after which a command that stops the robot is repeated if it had no effect, in seconds."""
_EFFECT_WITHIN = 1.5
"""Maximum time from a command to the report of its effect, in seconds."""


class TaskOrders:
    """Pauses, resumes and cancels one task at a time. Used in the event loop of the link.

    A pause or a cancellation is repeated until the robot reports its effect, because it only stops
    the robot. A pause is sent again if the robot drives on. A resumption is sent once, when there
    is a link.

    Args:
        chassis: the link.
        gate: sends the commands.
        requests: addresses the requests.
        is_current: returns True unless the robot executes another task, which would get commands.
        inquire: asks the robot about the task.

    Attributes:
        paused: True if the robot has reported that the task is paused.
        stands: True if it is paused and was not resumed since.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        requests: RequestMaker,
        is_current: Callable[[], bool],
        inquire: Callable[[], None],
    ) -> None:
        self._chassis = chassis
        self._gate = gate
        self._requests = requests
        self._is_current = is_current
        self._inquire = inquire
        self.paused = False
        self.stands = False
        self._task_id = 0
        self._wanted: action.Order | None = None
        """Command that the robot must obey; None without one."""
        self._sent_at = dict.fromkeys((action.kPause, action.kContinue), -math.inf)
        """Loop times of a pause and a resumption whose effects were not reported yet; else minus
        infinity."""
        self._wake = asyncio.Event()
        self._log = LogOnce(_LOG)
        self._insisting: asyncio.Task[None] | None = None
        """Sends `_wanted` until the robot has obeyed."""
        self._tasks = BackgroundTasks("vda5050 task orders")
        chassis.on_state(lambda state: self._wake.set())

    def begin(self, task_id: int) -> None:
        """Control another task, which runs; 0 for none."""
        self._task_id = task_id
        self._wanted = None
        self.paused = self.stands = False
        self._sent_at = dict.fromkeys(self._sent_at, -math.inf)
        self._log.clear()
        self._wake.set()

    def pause(self) -> None:
        """Keep the task paused."""
        self._want(action.kPause)

    def resume(self) -> None:
        """Let the task go on."""
        self._want(action.kContinue)

    def cancel(self) -> None:
        """Cancel the task."""
        self._want(action.kCancel)

    def reported(self, paused: bool) -> bool:
        """Take a report on the task.

        Args:
            paused: the task is paused.

        Returns:
            True if `paused` or `stands` has changed.
        """
        before = (self.paused, self.stands)
        self.paused = paused
        self._sent_at[action.kPause if paused else action.kContinue] = -math.inf
        self.stands = paused and not self._may_take_effect(action.kContinue)
        changed = (self.paused, self.stands) != before
        if changed:
            self._wake.set()
        self._control()
        return changed

    async def close(self) -> None:
        """Send nothing more."""
        await self._tasks.close()

    def _want(self, order: action.Order) -> None:
        if self._task_id and self._wanted != action.kCancel:
            self._wanted = order
            self._wake.set()
            self._control()

    def _control(self) -> None:
        """Start to send the wanted command, unless the robot has obeyed it."""
        if self._due() is not None and (self._insisting is None or self._insisting.done()):
            self._insisting = self._tasks.start(self._insist())

    async def _insist(self) -> None:
        """Send the wanted command until the robot has obeyed it."""
        while (order := self._due()) is not None:
            self._wake.clear()
            if self._chassis.state is LinkState.READY and self._is_current():
                self._sent_at[order] = asyncio.get_running_loop().time()
                if order == action.kContinue:
                    self._wanted, self.stands = None, False
                self._tasks.start(self._send(order, self._task_id))
            with contextlib.suppress(TimeoutError):
                await run_with_timeout(_REPEAT_AFTER, self._wake.wait())

    def _due(self) -> action.Order | None:
        """Return the command that the robot has not obeyed; None without one."""
        if self._wanted == action.kPause and self.stands:
            return None
        runs = not self.paused and not self._may_take_effect(action.kPause)
        if self._wanted == action.kContinue and runs:
            self._wanted = None
        return self._wanted

    def _may_take_effect(self, order: action.Order) -> bool:
        """Return True if a command was sent that may still take effect."""
        return asyncio.get_running_loop().time() < self._sent_at[order] + _EFFECT_WITHIN

    async def _send(self, order: action.Order, task_id: int) -> None:
        name = action.Order.Name(order)
        try:
            answer = await self._gate.request(self._requests.address(ActionOrder(order=order)))
        except LinkError as error:
            self._log.warn(f"{name} {task_id}", f"{name} of task {task_id} failed: {error}")
            is_unsent = isinstance(error, NotConnectedError | TooManyRequestsError)
            if is_unsent and order == action.kContinue and self._wanted is None:
                self._wanted = order
        else:
            if not answer.ok and task_id == self._task_id:
                self._log.warn(
                    f"{name} {task_id}", f"the robot refused {name} of task {task_id}: {answer.msg}"
                )
        if task_id == self._task_id:
            self._inquire()
