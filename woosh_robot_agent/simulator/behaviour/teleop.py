"""Remote control: velocity commands that must be repeated."""

from __future__ import annotations

from woosh_robot_agent.simulator.body.base import Base, Velocity

COMMAND_TIMEOUT = 0.5
"""Time after which the base slows down unless a new command arrives, in seconds."""


class Teleop:
    """Drives the base by the last velocity command until the command times out."""

    def __init__(self) -> None:
        self._velocity: Velocity | None = None
        self._left = 0.0

    def command(self, velocity: Velocity) -> None:
        """Drive with this velocity until the next command, or until the timeout."""
        self._velocity = velocity
        self._left = COMMAND_TIMEOUT

    def release(self) -> None:
        """Drop the last command. The base slows down."""
        self._velocity = None

    def tick(self, base: Base, dt: float) -> None:
        """Drive `base` for `dt` seconds if there is a command."""
        if self._velocity is None:
            return
        base.drive(self._velocity)
        self._left -= dt
        if self._left <= 1e-9:
            self.release()
