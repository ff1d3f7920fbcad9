"""Statistics of measured times."""

from __future__ import annotations

import contextlib
import gc
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

Measured = dict[str, tuple[float, str]]
"""Figures of one repetition, by name: the value, and a text with the measurements behind it."""
MICROSECONDS = 1e6
"""Microseconds in a second."""


@dataclass(frozen=True)
class Spread:
    """Median and 99th percentile of some times, in microseconds."""

    median: float
    p99: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Spread:
        """Return the spread of times in seconds."""
        ordered = sorted(seconds)
        p99 = ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))]
        return cls(statistics.median(ordered) * MICROSECONDS, p99 * MICROSECONDS)

    def __str__(self) -> str:
        return f"{self.median:.0f} (p99 {self.p99:.0f})"


@contextlib.contextmanager
def no_garbage_collection() -> Iterator[None]:
    """Disable Python's garbage collector in this process while the block runs."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
