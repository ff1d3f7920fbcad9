"""Estimation of the time at which a moving robot measured the pose in a report."""

from __future__ import annotations

import math

from woosh_robot_agent.standard.velocity import LEVER, Velocity

_MIN_SPEED = 0.1
"""Minimum mean speed from which the duration of a movement is derived, in m/s."""
_TOLERANCE = 1.1
"""Factor on that duration, because the reported speeds are inexact."""
_MAX_DELAY = 0.25
"""Maximum delay that is corrected, in seconds."""
_CORRECTION = 0.7
"""Share of a delay that is corrected. The rest is not, so that a lasting delay is adopted."""


class ReportTime:
    """Estimates when the pose in each report was measured, without the jitter of the network.

    If the time of receipt were used for a delayed report, the pose would fall behind, and would
    have to catch up with the next report. The movement between two reports, divided by the
    reported speeds, gives the time between them. A report that comes later was delayed.
    """

    def __init__(self) -> None:
        self._last = -math.inf
        """Estimated time of the previous report."""

    def first(self, received: float) -> float:
        """Return the time of a report that cannot be compared with the previous one.

        Args:
            received: time of receipt, in seconds.
        """
        self._last = received
        return received

    def next(
        self, received: float, arc: tuple[float, float, float], before: Velocity, after: Velocity
    ) -> float:
        """Return the time of a report, which is never after its receipt.

        Args:
            received: time of receipt, in seconds.
            arc: movement since the previous report, as in `Pose2D.arc`.
            before: velocity in the previous report.
            after: velocity in this report.
        """
        time = received
        forward = (before.forward + after.forward) / 2
        edge = (before.turn + after.turn) / 2 * LEVER
        square = forward * forward + edge * edge
        if before.moving and square > _MIN_SPEED * _MIN_SPEED:
            duration = (forward * arc[0] + edge * arc[2] * LEVER) / square
            delay = received - self._last - _TOLERANCE * max(duration, 0.0)
            if 0.0 < delay < _MAX_DELAY:
                time -= _CORRECTION * delay
        self._last = time
        return time
