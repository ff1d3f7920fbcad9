"""Poses in the plane, and how they chain. Metres and radians, angles counter-clockwise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Plane:
    """The pose of one frame in another: a rotation by `theta`, then a shift by (`x`, `y`)."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    @classmethod
    def of(cls, pose: Any) -> Plane:
        """From a message with `x`, `y` and `theta`."""
        return cls(pose.x, pose.y, pose.theta)

    def __mul__(self, other: Plane) -> Plane:
        """`other`, which is given in this frame, in the frame that this one is given in."""
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        return Plane(
            self.x + cos * other.x - sin * other.y,
            self.y + sin * other.x + cos * other.y,
            math.remainder(self.theta + other.theta, math.tau),
        )

    @property
    def inverse(self) -> Plane:
        """The pose of the other frame in this one."""
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        return Plane(-cos * self.x - sin * self.y, sin * self.x - cos * self.y, -self.theta)

    @property
    def distance(self) -> float:
        """From the origin, in m."""
        return math.hypot(self.x, self.y)

    @property
    def quaternion(self) -> tuple[float, float]:
        """The rotation as the z and w of a quaternion; x and y are 0."""
        return math.sin(self.theta / 2), math.cos(self.theta / 2)
