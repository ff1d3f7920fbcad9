"""One timer for the deadlines of many requests."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable


class Expiry:
    """Calls a function when the earliest of many deadlines has passed.

    It has one timer in the event loop, which most deadlines do not touch: a timer for each request
    would be created and cancelled with each answer.

    Args:
        loop: the event loop.
        expire: called with the loop time; ends what has expired, and returns the next deadline, or
            infinity if there is none.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, expire: Callable[[float], float]) -> None:
        self._loop = loop
        self._expire = expire
        self._timer: asyncio.TimerHandle | None = None
        self._at = math.inf
        """Loop time of the timer."""

    def watch(self, deadline: float) -> None:
        """Add a deadline, in loop time."""
        if deadline < self._at:
            self.cancel()
            self._at = deadline
            self._timer = self._loop.call_at(deadline, self._due)

    def cancel(self) -> None:
        """Forget all deadlines."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer, self._at = None, math.inf

    def _due(self) -> None:
        self._timer, self._at = None, math.inf
        self.watch(self._expire(self._loop.time()))
