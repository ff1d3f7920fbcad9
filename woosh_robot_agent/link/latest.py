"""Velocity commands: the newest one counts, and a stale one must never reach the robot."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.link.errors import SupersededError
from woosh_robot_agent.link.timeouts import within

T = TypeVar("T")

STALL = 0.5
"""s without an answer after which further commands are held back: as long as the chassis itself
goes on with the last one that it got."""


DRIVING = 3 * STALL
"""s after a velocity in which the robot may still drive by it: the chassis goes on with it for a
while, and then slows down by itself."""


class LatestWins(Generic[T]):
    """Sends commands at once while the chassis answers; holds only the newest while it does not.

    A stop, which is the command with nothing but zeros, is never held back, and no older command
    overtakes it.
    """

    def __init__(self) -> None:
        self._unanswered: dict[int, float] = {}
        self._held: asyncio.Future[None] | None = None
        self._newest = 0
        self._drives_until = -math.inf

    @property
    def driving(self) -> bool:
        """Whether the robot may still drive by a command that was sent here."""
        return time.monotonic() < self._drives_until

    def stopped(self) -> None:
        """The robot does not drive by a command from here any more."""
        self._drives_until = -math.inf

    async def request(self, command: Message, send: Callable[[float], Awaitable[T]]) -> T:
        """Send a command and wait for its answer.

        Args:
            command: the command.
            send: sends it and returns its answer; gets the s after which the command is too old
                to be sent.

        Raises:
            SupersededError: the command was held back, and a newer one came or it got too old.
            LinkError: as the sending function does.
        """
        self._newest += 1
        serial = self._newest
        moves = any(value for _, value in command.ListFields())
        self._release(SupersededError("not sent: a newer velocity command took its place"))
        if moves and self._stalled():
            await self._hold()
            if serial != self._newest:
                raise SupersededError("not sent: a newer velocity command took its place")
        if moves:
            self._drives_until = time.monotonic() + DRIVING
        self._unanswered[serial] = asyncio.get_running_loop().time()
        try:
            answer = await send(STALL if moves else math.inf)
            if not moves and serial == self._newest:
                self.stopped()
            return answer
        finally:
            del self._unanswered[serial]
            if not self._stalled():
                self._release(None)

    def _stalled(self) -> bool:
        now = asyncio.get_running_loop().time()
        return any(now - sent > STALL for sent in self._unanswered.values())

    async def _hold(self) -> None:
        held: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._held = held
        try:
            await within(STALL, held)
        except TimeoutError:
            raise SupersededError(
                "not sent: the chassis does not answer the velocity commands before it, "
                f"and after {STALL:g} s this one is too old; check the link, and stop the robot"
            ) from None
        finally:
            if self._held is held:  # else a newer command is held already
                self._held = None

    def _release(self, error: SupersededError | None) -> None:
        if self._held is None or self._held.done():
            return
        if error is None:
            self._held.set_result(None)
        else:
            self._held.set_exception(error)
