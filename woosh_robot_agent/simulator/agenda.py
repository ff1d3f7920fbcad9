"""Calls that are due at given simulated times."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable

ROUNDING = 1e-9
"""Tolerance of comparisons between sums of time steps, in seconds."""

Call = Callable[[], object]
"""A call that is due at some time."""


class Agenda:
    """Calls in the order of the times at which they are due, equal times in the order of adding.

    Attributes:
        on_add: Called with the time of each new call.
    """

    def __init__(self) -> None:
        self.on_add: Callable[[float], object] = lambda time: None
        self._entries: list[tuple[float, int, Call]] = []
        self._numbers = itertools.count()

    @property
    def next_time(self) -> float:
        """Simulated time at which the next call is due, infinite if there is none."""
        return self._entries[0][0] if self._entries else math.inf

    def add(self, time: float, call: Call) -> None:
        """Add a call that is due at a simulated time, in seconds."""
        heapq.heappush(self._entries, (time, next(self._numbers), call))
        self.on_add(time)

    def pop(self) -> Call:
        """Remove the next call and return it."""
        return heapq.heappop(self._entries)[2]
