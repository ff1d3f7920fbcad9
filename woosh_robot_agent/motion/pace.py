"""The pace of a stream that has a maximum rate."""

from __future__ import annotations

import math

_JITTER = 0.5
"""Delay of a message that does not delay the next one, in periods of the rate."""


class Pace:
    """The times at which the next message of a stream may be sent.

    On average, no more messages are sent than the rate allows. A message that comes a little late
    does not delay the next ones: at the maximum rate, all of them would be as late.
    """

    def __init__(self) -> None:
        self._slot = -math.inf
        """Time from which the period of the last message counts, in seconds."""

    def due(self, rate: float) -> float:
        """Return the time from which the next message may be sent, at a rate in Hz."""
        return self._slot + 1.0 / rate

    def sent(self, now: float, rate: float) -> None:
        """Note that a message was sent."""
        due = self.due(rate)
        self._slot = due if due <= now < due + _JITTER / rate else now
