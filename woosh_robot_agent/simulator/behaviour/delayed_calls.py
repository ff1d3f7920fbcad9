"""Calls that are due later and can be cancelled together."""

from __future__ import annotations

from collections.abc import Callable

from woosh_robot_agent.simulator.behaviour.robot import Robot


class DelayedCalls:
    """Calls that are due later and can be cancelled together.

    Args:
        robot: Schedules the calls.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._cancellations = 0
        """Number of calls of `cancel_all`."""

    def add(self, delay: float, call: Callable[[], object]) -> None:
        """Schedule a call in `delay` seconds of simulated time, or call now if that is 0."""
        cancellations = self._cancellations

        def call_unless_cancelled() -> None:
            if self._cancellations == cancellations:
                call()

        self._robot.after(delay, call_unless_cancelled)

    def cancel_all(self) -> None:
        """Cancel the calls that are not yet due."""
        self._cancellations += 1
