"""Plane geometry: poses, walls, outlines and gaps, in metres and radians (counter-clockwise).

The gap between an outline and walls is the distance by which all sides of the outline could move
outwards before one touches a wall. A negative gap is the depth to which a wall has entered the
outline. A base that overlaps a wall may only make moves that do not reduce the gap.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2

Point = tuple[float, float]
"""A position: x and y in metres."""


def wrap(angle: float) -> float:
    """Return the same angle in (-pi, pi]."""
    wrapped = math.remainder(angle, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


@dataclass(frozen=True, slots=True)
class Pose:
    """A position in metres and a heading in radians, in the map's frame unless said otherwise."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    @property
    def point(self) -> Point:
        """Position without the heading."""
        return self.x, self.y

    def moved(self, forward: float, left: float, turn: float) -> Pose:
        """Return the pose after a displacement in the frame of this pose, in metres and radians."""
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
        """Return the angle from the heading to the direction of `point`, in radians: (-pi, pi]."""
        return wrap(math.atan2(point[1] - self.y, point[0] - self.x) - self.theta)

    def __str__(self) -> str:
        return f"({self.x:.2f}, {self.y:.2f}, {self.theta:.2f})"


@dataclass(frozen=True, slots=True)
class Wall:
    """A straight wall without thickness from (x1, y1) to (x2, y2), in metres in the map's frame."""

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
        """Return the distance between the wall and the line from `start` to `end`, in metres."""
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
        """Return True if the line from `start` to `end` crosses the wall, not just touches it."""
        first, second = (self.x1, self.y1), (self.x2, self.y2)
        return (
            _side(start, end, first) * _side(start, end, second) < 0.0
            and _side(first, second, start) * _side(first, second, end) < 0.0
        )


def _side(start: Point, end: Point, point: Point) -> float:
    """Return a positive number if `point` is left of the line, a negative one if right of it."""
    return (end[0] - start[0]) * (point[1] - start[1]) - (end[1] - start[1]) * (point[0] - start[0])


Outline = tuple[Point, ...]
"""Corners in the frame of the base (x forward, y left), in metres."""


def footprints(original: Outline) -> dict[int, Outline]:
    """Return the outlines of a robot by `woosh.robot.FootPrint`, from the outline as built."""
    return {
        util_robot_pb2.kOriginal: original,
        util_robot_pb2.kExpand: _grown(original, 0.15),
        util_robot_pb2.kSpare: _grown(original, 0.05),
        util_robot_pb2.kDock: _grown(original, -0.05),
    }


def _grown(outline: Outline, margin: float) -> Outline:
    """Return an outline with its corners `margin` metres further out in x and in y."""
    return tuple((x + math.copysign(margin, x), y + math.copysign(margin, y)) for x, y in outline)


def outer_radius(outline: Outline) -> float:
    """Return the radius of the circle in which the robot turns on the spot, in metres."""
    return max(math.hypot(x, y) for x, y in outline)


class Hull:
    """A convex outline around the centre of the base, described by its sides.

    Attributes:
        radius: distance from the centre of the base to the outermost corner, in metres. Anything
            further away cannot touch the outline at any heading.
        sides: for each side the unit normal (x, y) that points outwards, and the distance of the
            side from the centre of the base in metres.
    """

    def __init__(self, outline: Outline) -> None:
        self.radius = outer_radius(outline)
        self.sides = tuple(_sides(outline))

    def gap(self, pose: Pose, walls: Iterable[Wall]) -> float:
        """Return the gap in metres between the outline at `pose` and the nearest wall.

        It is infinite if no wall is within `radius` of the centre.
        """
        x, y, radius = pose.x, pose.y, self.radius
        gaps = (
            self._wall_gap(pose, wall)
            for wall in walls
            # the first two conditions exclude most walls quickly
            if min(wall.x1, wall.x2) - radius <= x <= max(wall.x1, wall.x2) + radius
            and min(wall.y1, wall.y2) - radius <= y <= max(wall.y1, wall.y2) + radius
            and wall.distance(x, y) <= radius
        )
        return min(gaps, default=math.inf)

    def _wall_gap(self, pose: Pose, wall: Wall) -> float:
        """Return the gap between the outline at `pose` and a wall, in metres.

        A point has a signed distance from each side, positive outside. Its gap is the greatest of
        them. The gap of the wall is the smallest gap of its points.
        """
        x1, y1 = pose.local(wall.x1, wall.y1)
        x2, y2 = pose.local(wall.x2, wall.y2)
        # Along the wall, the distance from a side is linear: its value at the start, and its slope.
        lines = [
            (nx * x1 + ny * y1 - distance, nx * (x2 - x1) + ny * (y2 - y1))
            for nx, ny, distance in self.sides
        ]
        # The gap at a position is the highest line there. Follow that line until it rises.
        position = 0.0  # along the wall, from 0 to 1
        start, slope = max(lines)
        while slope < 0.0:
            crossings = (
                (max(position, (start - new_start) / (new_slope - slope)), new_slope, new_start)
                for new_start, new_slope in lines
                if new_slope > slope
            )
            position, next_slope, next_start = min(crossings, default=(math.inf, 0.0, 0.0))
            if position >= 1.0:  # it falls up to the end of the wall
                return start + slope
            start, slope = next_start, next_slope
        return start + slope * position


def _sides(outline: Outline) -> Iterable[tuple[float, float, float]]:
    """Yield the sides of an outline: unit normal (x, y) that points outwards, and distance (m)."""
    for (x1, y1), (x2, y2) in pairwise((*outline, outline[0])):
        length = math.hypot(x2 - x1, y2 - y1)
        if not length:  # the outline is closed by its first corner, or repeats a corner
            continue
        nx, ny = (y2 - y1) / length, (x1 - x2) / length
        distance = nx * x1 + ny * y1
        # An outline may be clockwise or counter-clockwise, but it encloses the centre.
        yield (nx, ny, distance) if distance > 0.0 else (-nx, -ny, -distance)


@lru_cache(maxsize=16)
def hull(outline: Outline) -> Hull:
    """Return the hull of an outline, from a cache."""
    return Hull(outline)
