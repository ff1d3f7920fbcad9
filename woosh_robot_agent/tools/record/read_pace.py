"""Limit on the rate of reads from a connection that carries many small frames."""

from __future__ import annotations

import asyncio

_BURST = 20
"""Number of reads that may follow each other at once."""
_LARGE = 16 * 1024
"""Size of a read from which the next one follows at once, in bytes."""


class ReadPace:
    """Delays reads of a stream so that frames that arrive at high rates are read together.

    To wake up for a frame costs several times what reading one more frame does.

    Args:
        transport: Transport that the stream is read from.
        period: Time between two reads at high rates, in seconds.
    """

    def __init__(self, transport: asyncio.BaseTransport, period: float) -> None:
        assert isinstance(transport, asyncio.ReadTransport)
        self._transport = transport
        self._period = period
        self._now = asyncio.get_running_loop().time
        self._due = 0.0
        """Loop time at which the next read would follow at an even rate."""

    async def wait(self, size: int) -> None:
        """Wait until the next read may follow.

        Args:
            size: Size of the previous read, in bytes.
        """
        if size >= _LARGE:
            return
        now = self._now()
        self._due = max(self._due, now - _BURST * self._period) + self._period
        if self._due > now:
            self._transport.pause_reading()
            await asyncio.sleep(self._due - now)
            self._transport.resume_reading()
