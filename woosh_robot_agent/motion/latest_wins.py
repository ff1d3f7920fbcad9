"""Back-pressure for velocities: while the chassis does not answer, only the newest one waits."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

from woosh_robot_agent.link import SupersededError
from woosh_robot_agent.link.timeouts import run_with_timeout
from woosh_robot_agent.motion.requests import may_move
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist

T = TypeVar("T")

STALL = 0.5
"""Time without an answer after which further velocities are held back, in seconds.

It is also the maximum age at which a velocity is sent. The chassis itself keeps the last velocity
that it received for the same time.
"""
_NEWER = "replaced by a newer velocity command"


class LatestWins(Generic[T]):
    """Sends velocities at once while the chassis answers, and holds only the newest otherwise.

    A zero is never held back, and no older velocity overtakes it.
    """

    def __init__(self) -> None:
        self._unanswered: dict[int, float] = {}
        """Loop times at which unanswered velocities were sent, by serial number."""
        self._held: asyncio.Future[None] | None = None
        """Future of the velocity that is held back; done when it may be sent or is superseded."""
        self._newest = 0
        """Serial number of the newest velocity."""

    async def request(
        self,
        velocity: Twist,
        send: Callable[[float], Awaitable[T]],
        published: float,
        max_age: float = math.inf,
    ) -> T:
        """Send a velocity and wait for its answer.

        Args:
            velocity: the velocity.
            send: sends it and returns its answer; called with the maximum time that it may wait to
                be sent, in seconds.
            published: loop time at which its sender published it.
            max_age: maximum age at which it is sent, in seconds, if that is less than `STALL`.

        Raises:
            SupersededError: a newer velocity replaced it, or it became too old.
            LinkError: raised by `send`.
        """
        now = asyncio.get_running_loop().time
        moves = may_move(velocity)
        limit = min(max_age, STALL)
        if moves and (age := now() - published) > limit:  # it does not replace a newer one
            raise SupersededError(f"not sent: it is {age:.2f} s old, and {limit:g} s are allowed")
        self._newest += 1
        serial = self._newest
        self.withdraw(_NEWER)
        if moves and self._stalled():
            await self._hold(published + limit - now())
            if serial != self._newest:
                raise SupersededError(f"not sent: {_NEWER}")
        self._unanswered[serial] = now()
        try:
            return await send(published + limit - now() if moves else math.inf)
        finally:
            del self._unanswered[serial]
            if not self._stalled():
                self._release()

    @property
    def in_flight(self) -> bool:
        """True if a velocity was sent and is not answered."""
        return bool(self._unanswered)

    def withdraw(self, reason: str) -> None:
        """Discard the velocity that is held back; its `request` fails for `reason`."""
        if self._held is not None and not self._held.done():
            self._held.set_exception(SupersededError(f"not sent: {reason}"))

    def _release(self) -> None:
        if self._held is not None and not self._held.done():
            self._held.set_result(None)

    def _stalled(self) -> bool:
        now = asyncio.get_running_loop().time()
        return any(now - sent > STALL for sent in self._unanswered.values())

    async def _hold(self, timeout: float) -> None:
        held: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._held = held
        try:
            await run_with_timeout(timeout, held)
        except TimeoutError:
            raise SupersededError(
                "not sent: the chassis does not answer earlier velocity commands, and this one "
                "has become too old; check the link, and stop the robot"
            ) from None
        finally:
            if self._held is held:  # otherwise a newer velocity is held already
                self._held = None
