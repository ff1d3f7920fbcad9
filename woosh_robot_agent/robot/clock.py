"""The difference between the robot's clock and this computer's, in words."""

from __future__ import annotations

TOLERANCE = 1.0
"""Maximum difference of the clocks without a warning, in seconds."""
_UNITS = (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0))
"""Units of long times, with their lengths in seconds."""


def describe_offset(offset: float) -> str:
    """Return the deviation of the robot's clock in words, e.g. `9.0 hours behind this computer's`.

    Args:
        offset: time by which the robot's clock is ahead of this computer's, in seconds.
    """
    direction = "ahead of" if offset > 0 else "behind"
    return f"{_duration(abs(offset))} {direction} this computer's"


def _duration(seconds: float) -> str:
    """Return a duration in the largest unit of which it has at least two."""
    for name, size in _UNITS:
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {name}"
    return f"{seconds:.1f} s"
