"""The velocity of a robot in the plane, in its own frame (REP 103)."""

from __future__ import annotations

from dataclasses import dataclass

_RESIDUAL_SPEED = 0.005
"""Maximum speed of a robot that stands, in m/s."""
_RESIDUAL_TURN = 0.005
"""Maximum angular speed of a robot that stands, in rad/s."""
LEVER = 0.3
"""Radius that converts angles to lengths, to compare turning with driving, in metres."""


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
        """True unless all speeds are so small that the robot stands."""
        return (
            abs(self.forward) > _RESIDUAL_SPEED
            or abs(self.left) > _RESIDUAL_SPEED
            or abs(self.turn) > _RESIDUAL_TURN
        )


STANDSTILL = Velocity()
