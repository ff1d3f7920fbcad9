"""Pauses between attempts to connect."""

from __future__ import annotations

import random

_JITTER = 0.2
"""Maximum share by which a pause is shortened at random, so that many agents do not retry in
step."""


class Backoff:
    """Pauses with jitter that double each time, until reset.

    Args:
        shortest: first pause, in seconds.
        longest: longest pause, in seconds.
    """

    def __init__(self, shortest: float, longest: float) -> None:
        self._shortest = shortest
        self._longest = longest
        self._next = shortest

    def next(self) -> float:
        """Return the pause before the next attempt, in seconds."""
        pause = self._next
        self._next = min(self._longest, pause * 2)
        return pause * (1 - _JITTER * random.random())

    def reset(self) -> None:
        """Start again with the shortest pause."""
        self._next = self._shortest
