"""Remote control: a speed that must be repeated."""

from __future__ import annotations

from woosh_robot_agent.simulator.body.base import Base, Velocity

#: After so many seconds without a new command the base slows down to a stop.
PATIENCE_S = 0.5


class Teleop:
    """The last commanded speed, while it is fresh."""

    def __init__(self) -> None:
        self._velocity: Velocity | None = None
        self._left = 0.0

    def command(self, velocity: Velocity) -> None:
        """Drive like this until the next command, at most `PATIENCE_S` seconds."""
        self._velocity = velocity
        self._left = PATIENCE_S

    def release(self) -> None:
        """Forget the command: the base slows down."""
        self._velocity = None

    def tick(self, base: Base, dt: float) -> None:
        """Drive `base` for the next `dt` seconds, if there is a fresh command."""
        if self._velocity is None:
            return
        base.drive(self._velocity)
        self._left -= dt
        if self._left <= 1e-9:
            self.release()
