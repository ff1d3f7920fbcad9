"""Detection of a lost link: the other end is silent, or has stopped reading."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from woosh_robot_agent.link.errors import ConnectionLostError, RequestTimeoutError
from woosh_robot_agent.link.timeouts import run_with_timeout
from woosh_robot_agent.link.transport.base import Transport

_IDLE_SHARE = 0.4
"""Share of the timeout that may pass in silence before the other end is probed."""
_MARGIN = 0.03
"""Share of the timeout kept for timers that fire late, so that the timeout is not exceeded."""
_BUSY_SHARE = 0.3
"""A timer that fires late by more than this share of the timeout shows that this program was busy.
The delay is not counted as silence, because the remaining time could be too short for an answer."""


class Liveness:
    """Decides whether the other end of one connection is alive.

    Signs of life are valid frames, and bytes of unfinished frames in either direction: a map of
    several MiB may take longer than the timeout.

    Args:
        transport: the transport to watch.
        timeout: time without a sign of life after which the link counts as lost, in seconds.
        probe: asks for a sign of life and waits for it.
        sent: returns the number of frames that the transport has taken so far.
    """

    def __init__(
        self,
        transport: Transport,
        timeout: float,
        probe: Callable[[], Awaitable[None]],
        sent: Callable[[], int],
    ) -> None:
        self._transport = transport
        self._timeout = timeout
        self._usable_timeout = timeout * (1 - _MARGIN)
        self._probe = probe
        self._sent = sent
        self._now = asyncio.get_running_loop().time
        self._heard_at = self._taken_at = self._now()
        self._previous = (sent(), 0)
        """Frames sent, and bytes waiting to be sent, at the last check."""

    def heard(self) -> None:
        """Note a sign of life."""
        self._heard_at = self._now()

    async def watch(self) -> None:
        """Watch the connection for as long as the other end is alive.

        Raises:
            ConnectionLostError: the other end is no longer alive.
        """
        while True:
            quiet = self._check()
            if quiet < self._timeout * _IDLE_SHARE:
                await self._sleep(self._timeout * _IDLE_SHARE - quiet)
                continue
            try:
                await run_with_timeout(max(self._usable_timeout - quiet, 0.01), self._ask())
            except (TimeoutError, RequestTimeoutError):
                if self._check() >= self._usable_timeout:
                    raise ConnectionLostError(
                        f"nothing was heard for {self._timeout:g} s; check that the robot is on "
                        "and that the network reaches it"
                    ) from None

    async def _sleep(self, seconds: float) -> None:
        """Sleep. A delay because this program was busy does not count as silence."""
        due = self._now() + seconds
        await asyncio.sleep(seconds)
        late = self._now() - due
        if late > self._timeout * _BUSY_SHARE:
            self._heard_at += late
            self._taken_at += late

    async def _ask(self) -> None:
        await self._probe()
        self.heard()

    def _check(self) -> float:
        """Return the time since the last sign of life, in seconds.

        Raises:
            ConnectionLostError: the other end has stopped reading.
        """
        now = self._now()
        self._heard_at = max(self._heard_at, self._transport.progress_at)
        sent, backlog = self._sent(), self._transport.backlog()
        previous_sent, previous_backlog = self._previous
        self._previous = sent, backlog
        if sent == previous_sent and backlog < previous_backlog:
            self._heard_at = now
        if not backlog or sent != previous_sent or backlog < previous_backlog:
            self._taken_at = now
        elif now - self._taken_at >= self._timeout:
            raise ConnectionLostError(
                f"the chassis has read nothing for {self._timeout:g} s; bytes waiting to be sent: "
                f"{backlog}"
            )
        return now - self._heard_at
