"""The pace of a stream that has a maximum rate."""

from __future__ import annotations

import math

_LATE = 0.5
"""Delay of a message that does not delay the next one, in periods of the rate."""
_EARLY = 0.1
"""Maximum earliness of a message that is sent at once, in periods of the rate."""


class Pace:
    """The times at which the next message of a stream may be sent.

    On average, no more messages are sent than the rate allows. A message that comes a little late
    does not delay the next ones: at the maximum rate, all of them would be as late. A message that
    comes a little early is sent at once, because the first one may have been late.
    """

    def __init__(self) -> None:
        self._slot = -math.inf
        """Time from which the period of the last message counts, in seconds."""

    def due(self, rate: float) -> float:
        """Return the time from which the next message may be sent, at a rate in Hz."""
        return self._slot + (1.0 - _EARLY) / rate

    def sent(self, now: float, rate: float) -> None:
        """Note that a message was sent."""
        slot = self._slot + 1.0 / rate
        self._slot = slot if now < slot + _LATE / rate else now
