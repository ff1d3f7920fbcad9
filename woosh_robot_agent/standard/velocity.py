"""The velocity of a robot in the plane, in its own frame (REP 103)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity in the robot's frame.

    Attributes:
        forward: speed along x, in m/s.
        left: speed along y, in m/s.
        turn: angular speed, counter-clockwise, in rad/s.
    """

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0

    @property
    def moving(self) -> bool:
        """True unless all speeds are zero."""
        return bool(self.forward or self.left or self.turn)


STANDSTILL = Velocity()
