"""Detection of several publishers that send on one topic at the same time."""

from __future__ import annotations

from collections import deque

WINDOW = 2.5
"""Time within which several publishers count as simultaneous, in seconds.

Long enough to detect publishers at 1 Hz.
"""
_UNKNOWN = (None, 0, 2**64 - 1)
"""Sequence numbers that mean that the middleware does not number messages."""


class Interleaving:
    """Detects several publishers of a topic by the sequence numbers of their messages.

    Each publisher numbers its messages in ascending order. A number that is not above the previous
    one comes from another publisher, or from one that was restarted. If this happens twice within
    `WINDOW`, it was no restart.
    """

    def __init__(self) -> None:
        self._last = 0
        """Sequence number of the last message."""
        self._returns: deque[float] = deque(maxlen=2)
        """The last times at which the number did not rise."""

    def notice(self, number: int | None, now: float) -> bool:
        """Process the number of a message.

        Args:
            number: publication sequence number.
            now: monotonic time.

        Returns:
            True if messages of several publishers alternate.
        """
        if number is None or number in _UNKNOWN:
            return False
        if number <= self._last:
            self._returns.append(now)
        self._last = number
        return len(self._returns) == 2 and now - self._returns[0] < WINDOW
