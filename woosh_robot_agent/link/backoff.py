"""Pauses between attempts to connect."""

from __future__ import annotations

import random

_JITTER = 0.2
"""Share by which a pause is shorter at random, so that many agents do not knock in step."""


class Backoff:
    """Pauses that double from `shortest` to `longest` s, with jitter, until reset."""

    def __init__(self, shortest: float, longest: float) -> None:
        self._shortest = shortest
        self._longest = longest
        self._next = shortest

    def next(self) -> float:
        """The pause before the next attempt, in s."""
        pause = self._next
        self._next = min(self._longest, pause * 2)
        return pause * (1 - _JITTER * random.random())

    def reset(self) -> None:
        """Start small again."""
        self._next = self._shortest
