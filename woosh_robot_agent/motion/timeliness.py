"""Decide whether a command is too old: its age, stalls of this process, and newer velocities."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any

from woosh_robot_agent.link import Answer, SupersededError
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.motion.requests import may_move
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.sentences import NOT_SENT, Sentence

_WINDOW = 10.0
"""Minimum time for which the smallest clock difference is remembered, in seconds; the maximum is
twice as long. A time in which no messages come does not count.

For that time, messages count as old after this computer's clock was set forward, or from a sender
whose clock is behind the clocks of other senders.
"""
_PERIOD = 0.25
"""Period of the heartbeat, in seconds."""


@dataclass(frozen=True)
class MotionTiming:
    """Times in the rules of motion, in seconds."""

    max_age: float = 0.5
    """Maximum age at which a velocity is sent. The chassis keeps a received one for as long."""
    unanswered: float = 0.5
    """Time without an answer to a velocity after which further velocities are held back."""
    driving: float = 1.5
    """Time for which the robot may keep driving after a velocity. The chassis keeps a velocity for
    a while, and then slows down by itself."""
    hold: float = 0.5
    """Time after a stop in which nothing that moves the robot is sent. A goal that a client sent
    before the stop may arrive after it."""
    effect: float = 1.5
    """Maximum time from a start or a cancel to the report of its effect. Real robots report it 0.5
    to 1.2 s after they have accepted the request."""
    stall: float = 0.5
    """Time without a heartbeat that counts as a stall."""
    settle: float = 0.5
    """Time after a stall in which commands may arrive that were sent before its end."""
    pause: float = 2.0
    """Time without any velocity of a stream after which its sender counts as paused."""


class SenderClock:
    """Times at which messages were sent, from the source times that their senders gave them.

    The clocks of two computers may differ by any amount, and neither is trusted. The time of
    receipt less the source time is the difference of the clocks plus the transit time. Its smallest
    value of the last 10 to 20 s in which messages came is taken for the difference of the clocks;
    the rest is transit time. The first message may be late itself: if its value is between 0 and
    `_WINDOW`, the clocks count as equal, and all of the value as transit time.
    """

    def __init__(self) -> None:
        self._since = -math.inf
        """Monotonic time at which the current window began."""
        self._least = math.inf
        """Smallest difference in the current window, in seconds."""
        self._least_before = math.inf
        """Smallest difference in the window before, in seconds."""

    def published(self, source: float, received: float, taken: float) -> float:
        """Return the monotonic time at which a message was sent, and learn from its times.

        Args:
            source: Unix time at which the message was sent, by the sender's clock; 0 if unknown.
            received: Unix time at which the middleware received the message; 0 if unknown.
            taken: monotonic time at which this process took the message from the middleware.
        """
        ahead = time.time() - time.monotonic()  # by which Unix time is ahead of monotonic time
        # use `taken` if the receipt is unknown, or the clock was set back since the receipt
        received = min(received or math.inf, taken + ahead)
        if not source:
            return received - ahead
        if taken > self._since + _WINDOW:
            self._since, self._least_before, self._least = taken, self._least, math.inf
        is_first = self._least == self._least_before == math.inf
        self._least = min(self._least, received - source)
        offset = min(self._least, self._least_before)
        if is_first and 0.0 < offset < _WINDOW:
            offset = 0.0
        return source + offset - ahead

    def of_message(self, info: Mapping[str, Any], taken: float) -> float:
        """Return the monotonic time at which a message on a topic was sent.

        Args:
            info: rclpy's information about the message.
            taken: as in `published`.
        """
        source, received = (
            info.get(f"{name}_timestamp", 0) / 1e9 for name in ("source", "received")
        )
        return self.published(source, received, taken)


def boot_time() -> float:
    """Return the time since boot in seconds, including suspensions of the computer."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class StallWatch:
    """Notices that the event loop, the whole process or the computer stood still.

    Args:
        timing: returns the current `MotionTiming`.

    Attributes:
        ended: monotonic time at which the end of the last stall was noticed; -inf before the first.
        duration: duration of the last stall, in seconds.
    """

    def __init__(self, timing: Callable[[], MotionTiming]) -> None:
        self._timing = timing
        self.ended = -math.inf
        self.duration = 0.0
        self._last = math.inf
        """Time of the last heartbeat, or of the end of a stall after it, by `boot_time`; inf before
        `start` and after `stop`."""
        self._timer: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Start watching the running event loop, unless it is being watched."""
        if self._timer is None:
            self._beat(asyncio.get_running_loop())

    def stop(self) -> None:
        """Stop watching; a stall that has just ended counts."""
        self.check()
        self._last = math.inf
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def check(self) -> None:
        """Notice a stall that has just ended, even before the next heartbeat. Thread-safe."""
        now = boot_time()
        if now - self._last > self._timing().stall:
            self.ended, self.duration = time.monotonic(), now - self._last
            self._last = now

    def is_from_before(self, published: float) -> bool:
        """Return True if a command may have been sent before the end of the last stall.

        Args:
            published: monotonic time at which the command was sent, or taken from the middleware.
        """
        return published < self.ended + self._timing().settle

    def _beat(self, loop: asyncio.AbstractEventLoop) -> None:
        """Note a heartbeat, and schedule the next one."""
        self.check()
        self._last, now = boot_time(), time.monotonic()
        # multiples of the period, so that the watches of all robots wake the loop at the same time
        self._timer = loop.call_at((now // _PERIOD + 1) * _PERIOD, self._beat, loop)


_NEWER = Sentence("replaced by a newer velocity command")()
_OLD = Sentence("it is {age} s old, and {limit} s are allowed")
_UNANSWERED = Sentence(
    "the chassis does not answer earlier velocity commands, and this one has become too old; check "
    "the link, and stop the robot"
)()


class LatestWins:
    """Sends velocities at once while the chassis answers, and holds only the newest otherwise.

    A zero is never held back, and no older velocity overtakes it.

    Args:
        timing: returns the current `MotionTiming`.
    """

    def __init__(self, timing: Callable[[], MotionTiming]) -> None:
        self._timing = timing
        self._unanswered: dict[int, float] = {}
        """Loop times at which unanswered velocities were sent, by serial number."""
        self._held: asyncio.Future[None] | None = None
        """Future of the velocity that is held back; done when it may be sent or is superseded."""
        self._newest = 0
        """Serial number of the newest velocity, or higher if one was discarded since."""

    async def request(
        self,
        velocity: Twist,
        send: Callable[[float], Awaitable[Answer]],
        published: float,
        max_age: float = math.inf,
    ) -> Answer:
        """Send a velocity and wait for its answer.

        Args:
            velocity: the velocity.
            send: sends the velocity and returns the answer; called with the maximum time that the
                velocity may wait to be sent, in seconds.
            published: loop time at which the sender published the velocity.
            max_age: maximum age at which the velocity is sent, in seconds, if that is less than
                `MotionTiming.max_age`.

        Raises:
            SupersededError: a newer velocity replaced it, or it became too old.
            LinkError: raised by `send`.
        """
        now = asyncio.get_running_loop().time
        moves = may_move(velocity)
        limit = min(max_age, self._timing().max_age)
        if moves and (age := now() - published) > limit:  # it must not replace a newer one
            old = _OLD(age=f"{age:.2f}", limit=f"{limit:g}")
            raise SupersededError(NOT_SENT(reason=old))
        self.withdraw(_NEWER)
        serial = self._newest
        if moves and self.is_answer_overdue:
            await self._hold(published + limit - now())
            if serial != self._newest:
                raise SupersededError(NOT_SENT(reason=_NEWER))
        self._unanswered[serial] = now()
        try:
            return await send(published + limit - now() if moves else math.inf)
        finally:
            del self._unanswered[serial]
            if not self.is_answer_overdue:
                self._release()

    @property
    def in_flight(self) -> bool:
        """True if a velocity was sent and is not answered."""
        return bool(self._unanswered)

    def withdraw(self, reason: str) -> None:
        """Discard the velocity that is held back; its `request` fails for `reason`."""
        self._newest += 1  # a velocity that was just released is not sent either
        if self._held is not None and not self._held.done():
            self._held.set_exception(SupersededError(NOT_SENT(reason=reason)))

    def _release(self) -> None:
        """Let the velocity that is held back be sent, if there is one."""
        if self._held is not None and not self._held.done():
            self._held.set_result(None)

    @property
    def is_answer_overdue(self) -> bool:
        """True if a velocity is unanswered for so long that newer ones are held back."""
        since = asyncio.get_running_loop().time() - self._timing().unanswered
        return any(sent < since for sent in self._unanswered.values())

    async def _hold(self, timeout: float) -> None:
        """Wait until a velocity may be sent.

        Raises:
            SupersededError: it was withdrawn, or the timeout in seconds has passed.
        """
        held: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._held = held
        try:
            await run_with_timeout(timeout, held)
        except TimeoutError:
            raise SupersededError(NOT_SENT(reason=_UNANSWERED)) from None
        finally:
            if self._held is held:  # otherwise a newer velocity is held already
                self._held = None
