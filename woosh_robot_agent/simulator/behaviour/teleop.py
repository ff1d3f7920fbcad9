"""Remote control: velocity commands that must be repeated."""

from __future__ import annotations

from woosh_robot_agent.simulator.agenda import ROUNDING
from woosh_robot_agent.simulator.body.base import Base, Velocity

COMMAND_TIMEOUT = 0.5
"""Time after which the base slows down unless a new command arrives, in seconds."""


class Teleop:
    """Drives the base by the last velocity command until the command times out.

    Args:
        start_delay: Time from the first command to the first motion, in seconds.
    """

    def __init__(self, start_delay: float) -> None:
        self._start_delay = start_delay
        self._waiting = 0.0
        """Remaining time until the base starts to move, in seconds."""
        self._velocity: Velocity | None = None
        """Velocity of the last command, None if there is none or it timed out."""
        self._left = 0.0
        """Remaining time until the last command times out, in seconds."""

    def command(self, velocity: Velocity) -> None:
        """Drive with this velocity until the next command, or until the timeout."""
        if self._velocity is None:
            self._waiting = self._start_delay
        self._velocity = velocity
        self._left = COMMAND_TIMEOUT

    def release(self) -> None:
        """Drop the last command. The base slows down."""
        self._velocity = None

    def tick(self, base: Base, dt: float) -> None:
        """Drive `base` for `dt` seconds if there is a command."""
        if self._velocity is None:
            return
        self._waiting = 0.0 if base.moving else self._waiting - dt
        if self._waiting <= ROUNDING:
            base.drive(self._velocity, rolls_on=True)
        self._left -= dt
        if self._left <= ROUNDING:
            self.release()
