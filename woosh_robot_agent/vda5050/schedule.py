"""Schedule of a message that is published on changes, with minimum and maximum intervals."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable


class Schedule:
    """Calls a function soon after each change, and at regular intervals without one.

    Args:
        send: publishes the message.
        shortest: minimum time between two calls, in seconds.
        longest: maximum time between two calls, in seconds; infinite to call on changes only.
    """

    def __init__(
        self, send: Callable[[], None], shortest: float, longest: float = math.inf
    ) -> None:
        self._send = send
        self._shortest = shortest
        self._longest = longest
        self._last = -math.inf
        """Loop time of the last call."""
        self._timer: asyncio.TimerHandle | None = None

    def changed(self) -> None:
        """Call the function as soon as the minimum time since the last call is over."""
        self.call_within(self._shortest)

    def call_within(self, interval: float) -> None:
        """Call the function as soon as `interval` seconds since the last call are over."""
        loop = asyncio.get_running_loop()
        due = max(loop.time(), self._last + interval)
        if self._timer is None or self._timer.when() > due:
            self._arm(due)

    def stop(self) -> None:
        """Make no more calls."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _arm(self, due: float) -> None:
        self.stop()
        self._timer = asyncio.get_running_loop().call_at(due, self._call)

    def _call(self) -> None:
        self._last = asyncio.get_running_loop().time()
        self._timer = None
        if self._longest < math.inf:
            self._arm(self._last + self._longest)
        self._send()
