"""Plane geometry: poses, walls and distances, in metres and radians (counter-clockwise)."""

from __future__ import annotations

import math
from dataclasses import dataclass

Point = tuple[float, float]
"""A position: x and y in metres."""


def wrap(angle: float) -> float:
    """Return the same angle in (-pi, pi]."""
    wrapped = math.remainder(angle, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


@dataclass(frozen=True, slots=True)
class Pose:
    """A position in metres and a heading in radians, in the map's frame by default."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    @property
    def point(self) -> Point:
        """Position without the heading."""
        return self.x, self.y

    def moved(self, forward: float, left: float, turn: float) -> Pose:
        """Return the pose after a displacement in the frame of this pose."""
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        return Pose(
            self.x + forward * cos - left * sin,
            self.y + forward * sin + left * cos,
            self.theta + turn,
        )

    def local(self, x: float, y: float) -> Point:
        """Return the point (x, y) in the frame of this pose: x forward, y left."""
        dx, dy = x - self.x, y - self.y
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        return dx * cos + dy * sin, dy * cos - dx * sin

    def distance(self, point: Point) -> float:
        """Return the distance to `point`, in metres."""
        return math.hypot(point[0] - self.x, point[1] - self.y)

    def bearing(self, point: Point) -> float:
        """Return the angle from the heading to the direction of `point`, in (-pi, pi]."""
        return wrap(math.atan2(point[1] - self.y, point[0] - self.x) - self.theta)

    def __str__(self) -> str:
        return f"({self.x:.2f}, {self.y:.2f}, {self.theta:.2f})"


@dataclass(frozen=True, slots=True)
class Wall:
    """A straight wall from (x1, y1) to (x2, y2), without thickness."""

    x1: float
    y1: float
    x2: float
    y2: float

    def distance(self, x: float, y: float) -> float:
        """Return the distance from (x, y) to the nearest point of the wall, in metres."""
        along_x, along_y = self.x2 - self.x1, self.y2 - self.y1
        length_squared = along_x * along_x + along_y * along_y
        share = 0.0
        if length_squared > 0.0:
            share = ((x - self.x1) * along_x + (y - self.y1) * along_y) / length_squared
            share = min(1.0, max(0.0, share))
        return math.hypot(self.x1 + share * along_x - x, self.y1 + share * along_y - y)

    def line_distance(self, start: Point, end: Point) -> float:
        """Return the distance from the line segment `start` to `end` to the wall, in metres."""
        if self.crosses(start, end):
            return 0.0
        line = Wall(*start, *end)
        return min(
            self.distance(*start),
            self.distance(*end),
            line.distance(self.x1, self.y1),
            line.distance(self.x2, self.y2),
        )

    def crosses(self, start: Point, end: Point) -> bool:
        """Return True if the line segment from `start` to `end` crosses the wall."""
        first, second = (self.x1, self.y1), (self.x2, self.y2)
        return (
            _side(start, end, first) * _side(start, end, second) < 0.0
            and _side(first, second, start) * _side(first, second, end) < 0.0
        )


def _side(start: Point, end: Point, point: Point) -> float:
    """Return a positive number if `point` is left of the line, a negative one if right of it."""
    return (end[0] - start[0]) * (point[1] - start[1]) - (end[1] - start[1]) * (point[0] - start[0])


def box(x1: float, y1: float, x2: float, y2: float) -> tuple[Wall, ...]:
    """Return the four walls of a rectangle that is parallel to the axes."""
    return (
        Wall(x1, y1, x2, y1),
        Wall(x2, y1, x2, y2),
        Wall(x2, y2, x1, y2),
        Wall(x1, y2, x1, y1),
    )
