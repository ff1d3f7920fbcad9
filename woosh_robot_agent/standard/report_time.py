"""The time at which a report of a moving robot was true."""

from __future__ import annotations

import math

from woosh_robot_agent.standard.velocity import Velocity

_LEVER = 0.3
"""Distance from the robot's centre at which turning counts as much as driving, in metres."""
_MIN_SPEED = 0.1
"""Minimum mean speed at which the duration of a movement is derived from it, in m/s."""
_TOLERANCE = 1.1
"""Factor on that duration, because the reported speeds are inexact."""
_MAX_DELAY = 0.25
"""Maximum delay that is corrected, in seconds."""
_CORRECTION = 0.7
"""Share of a delay that is corrected; the rest counts as lasting, so that the clocks converge."""


class ReportTime:
    """Estimates when each report was true, without the changing delays of the network.

    If a delayed report counted as true at its time of receipt, the pose would fall behind and the
    next report would make it hurry. The movement between two reports, divided by the speeds in
    them, gives the time between them. A report that comes later than that was delayed.
    """

    def __init__(self) -> None:
        self._last = -math.inf

    def first(self, received: float) -> float:
        """Return the time of a report that cannot be compared with the one before.

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
            arc: movement since the report before, as in `Pose2D.arc`.
            before: velocity in the report before.
            after: velocity in this report.
        """
        time = received
        forward = (before.forward + after.forward) / 2
        edge = (before.turn + after.turn) / 2 * _LEVER
        square = forward * forward + edge * edge
        if before.moving and square > _MIN_SPEED * _MIN_SPEED:
            duration = (forward * arc[0] + edge * arc[2] * _LEVER) / square
            delay = received - self._last - _TOLERANCE * max(duration, 0.0)
            if 0.0 < delay < _MAX_DELAY:
                time -= _CORRECTION * delay
        self._last = time
        return time
