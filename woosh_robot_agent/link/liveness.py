"""Notices when the other end is gone: from silence, and from its taking nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from woosh_robot_agent.link.errors import ConnectionLostError, RequestTimeoutError
from woosh_robot_agent.link.timeouts import within
from woosh_robot_agent.link.transports import Transport

_IDLE_SHARE = 0.4
"""Share of the limit that may pass in silence before the other end is asked for a sign of life."""
_MARGIN = 0.03
"""Share of the limit that is left for timers that come late, so that the limit is kept."""
_BUSY_SHARE = 0.3
"""Share of the limit by which a timer that comes late shows that this program itself was busy: what
is then left of the limit could be too short for an answer."""


class Liveness:
    """Judges one connection.

    Signs of life are valid frames, and bytes on their way in either direction: a map of several
    MiB may take longer than the limit.

    Args:
        transport: what to watch.
        limit: s without a sign of life within which the other end counts as gone.
        probe: asks for a sign of life and waits for it.
        sent: number of frames that the transport has taken so far.
    """

    def __init__(
        self,
        transport: Transport,
        limit: float,
        probe: Callable[[], Awaitable[None]],
        sent: Callable[[], int],
    ) -> None:
        self._transport = transport
        self._limit = limit
        self._patience = limit * (1 - _MARGIN)
        self._probe = probe
        self._sent = sent
        self._now = asyncio.get_running_loop().time
        self._heard = self._taken = self._now()
        self._before = (sent(), 0)

    def heard(self) -> None:
        """A sign of life came."""
        self._heard = self._now()

    async def watch(self) -> None:
        """Watch for as long as the other end lives.

        Raises:
            ConnectionLostError: it does no longer.
        """
        while True:
            quiet = self._look()
            if quiet < self._limit * _IDLE_SHARE:
                await self._pause(self._limit * _IDLE_SHARE - quiet)
                continue
            try:
                await within(max(self._patience - quiet, 0.01), self._asked())
            except (TimeoutError, RequestTimeoutError):
                if self._look() >= self._patience:
                    raise ConnectionLostError(
                        f"nothing was heard for {self._limit:g} s; is the robot on, and in reach "
                        "of the network?"
                    ) from None

    async def _pause(self, seconds: float) -> None:
        """Sleep; time by which that took too long, this program was busy and could hear nothing."""
        due = self._now() + seconds
        await asyncio.sleep(seconds)
        late = self._now() - due
        if late > self._limit * _BUSY_SHARE:
            self._heard += late
            self._taken += late

    async def _asked(self) -> None:
        await self._probe()
        self.heard()

    def _look(self) -> float:
        """The s since the last sign of life; raises when the other end takes nothing."""
        now = self._now()
        self._heard = max(self._heard, self._transport.heard)
        sent, backlog = self._sent(), self._transport.backlog()
        sent_before, backlog_before = self._before
        self._before = sent, backlog
        if sent == sent_before and backlog < backlog_before:
            self._heard = now
        if not backlog or sent != sent_before or backlog < backlog_before:
            self._taken = now
        elif now - self._taken >= self._limit:
            raise ConnectionLostError(
                f"the chassis has taken nothing for {self._limit:g} s, with {backlog} bytes waiting"
            )
        return now - self._heard
