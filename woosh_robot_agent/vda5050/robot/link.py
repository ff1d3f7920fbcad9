"""The link to the robot that all parts of a vehicle share, and their tasks in the background."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine, Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.endpoints import minimum_timeouts
from woosh_robot_agent.link import Answer, ChassisClient, LinkConfig, LinkState
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.motion import MotionGate

_LOG = logging.getLogger(__name__)
_READY_TIMEOUT = 5.0
"""Maximum time from a snapshot until the link is ready, in seconds."""


class Background:
    """Runs coroutines as asyncio tasks until they end, or until `close`. At most one per key."""

    def __init__(self) -> None:
        self._tasks: dict[Hashable, asyncio.Task[None]] = {}
        """Running tasks, by key."""

    def start(self, work: Coroutine[Any, Any, None], key: Hashable = None) -> asyncio.Task[None]:
        """Start a task, and return it; the task with the same key is cancelled.

        Args:
            key: key of the task; None for a task that runs beside all others.
        """
        key = object() if key is None else key
        if (former := self._tasks.pop(key, None)) is not None:
            former.cancel()
        task = asyncio.get_running_loop().create_task(work, name="vda5050")
        self._tasks[key] = task
        task.add_done_callback(lambda task: self._ended(key, task))
        return task

    def start_once(self, work: Callable[[], Coroutine[Any, Any, None]], key: Hashable) -> None:
        """Start a task, unless the task with the same key still runs."""
        task = self._tasks.get(key)
        if task is None or task.done():
            self.start(work(), key)

    async def close(self) -> None:
        """Cancel all tasks, and wait for their end."""
        tasks = tuple(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _ended(self, key: Hashable, task: asyncio.Task[None]) -> None:
        """Forget a task that has ended, and log its exception."""
        if self._tasks.get(key) is task:
            del self._tasks[key]
        if not task.cancelled() and (error := task.exception()) is not None:
            _LOG.error("an error of the program has ended %r", task.get_coro(), exc_info=error)


class Conditions:
    """Conditions for which actions wait. Call `check` after each event. Used in one event loop."""

    def __init__(self) -> None:
        self._waiting: dict[asyncio.Future[None], Callable[[], bool]] = {}
        """Conditions, by the future that is done once the condition holds."""

    async def wait(self, condition: Callable[[], bool], timeout: float | None = None) -> bool:
        """Wait until a condition holds; return False if this takes more than `timeout` seconds."""
        while not condition():  # also checked after a wait: it may not hold any more
            holds = asyncio.get_running_loop().create_future()
            self._waiting[holds] = condition
            try:
                await (holds if timeout is None else run_with_timeout(timeout, holds))
            except TimeoutError:
                return False
            finally:
                del self._waiting[holds]
        return True

    def check(self) -> None:
        """Wake the waiting callers whose condition holds now."""
        for holds, condition in self._waiting.items():
            if not holds.done() and condition():
                holds.set_result(None)


@dataclass(frozen=True)
class Timing:
    """How long the vehicle waits for the robot.

    Attributes:
        repeat_after: time after which a command that stops the robot is repeated if it had no
            effect, in seconds.
        pause_within: maximum time until the robot has paused or resumed everything, in seconds.
        ask_again_after: first pause before maps and marks are requested again after a failure, in
            seconds; it doubles with each failure.
        check_every: time between two queries about a task or action, in case a report on it was
            lost, in seconds.
        ask_every: time between two queries about a task or action of unknown state, in seconds.
        give_up_after: time for which the robot answers such queries, but does not know the task or
            action, until the vehicle gives it up, in seconds.
        minimum_timeouts: minimum timeouts of slow requests, in seconds, by protobuf full name.
    """

    repeat_after: float = 3.0
    pause_within: float = 10.0
    ask_again_after: float = 5.0
    check_every: float = 5.0
    ask_every: float = 1.0
    give_up_after: float = 3.0
    minimum_timeouts: Mapping[str, float] = field(default_factory=minimum_timeouts)


class RobotLink:
    """The link to the robot. Used in one asyncio event loop.

    Args:
        on_changed, on_moved, save: the functions of the attributes `changed`, `moved` and `save`.

    Attributes:
        chassis: client of the robot.
        gate: sends commands that move the robot, and tells who drives the robot.
        changed: call it after each event that may change the state of the vehicle, except a pose.
        moved: call it after each report of a pose.
        save: call it before a command, to save the state that must survive a restart.
        conditions: conditions of the vehicle that its actions wait for.
        background: asyncio tasks that end with the link.
        is_closing: True once the link is being closed; the robot continues its task or action.
    """

    def __init__(
        self,
        config: LinkConfig,
        timing: Timing,
        on_changed: Callable[[], None],
        on_moved: Callable[[], None],
        save: Callable[[], None],
    ) -> None:
        self.chassis = ChassisClient(config=config, minimum_timeouts=timing.minimum_timeouts)
        self.gate = MotionGate(self.chassis)
        self._requests = RequestMaker(config.robot_id)
        self.timing = timing
        self.changed = on_changed
        self.moved = on_moved
        self.save = save
        self.conditions = Conditions()
        self.background = Background()
        self.is_closing = False

    @property
    def ready(self) -> bool:
        """True while requests can be sent."""
        return self.chassis.state is LinkState.READY

    async def wait_ready(self) -> None:
        """Wait until the link is ready, which it becomes after the snapshot.

        Raises:
            NotConnectedError: the link is not ready in time.
        """
        await self.chassis.wait_ready(_READY_TIMEOUT)

    async def ask(self, request: Message, tap: Callable[[Answer], None] | None = None) -> Answer:
        """Send a request that moves nothing, and return the answer.

        `tap` is called with the answer before a later report of the robot is handled.

        Raises:
            LinkError: the request was not sent or not answered.
        """
        return await self.chassis.request(self._requests.address(request), tap=tap)

    async def command(
        self, request: Message, tap: Callable[[Answer], None] | None = None
    ) -> Answer:
        """Send a request that may move the robot, and return the answer.

        `tap` is called with the answer before a later report of the robot is handled.

        Raises:
            LinkError: the request was not sent or not answered; SupersededError if the motion gate
                forbids it.
        """
        return await self.gate.request(self._requests.address(request), tap=tap)
