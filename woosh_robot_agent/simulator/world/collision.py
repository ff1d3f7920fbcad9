"""Collision of the base's outline with what stands around it.

The measure is the gap: by how many metres each side of the outline could be moved out before it
meets something; negative is how deep something has come in. It is positive exactly where nothing
touches, and it grows on the way out of a collision, which is how a base gets free again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from itertools import pairwise

from woosh_robot_agent.simulator.world.footprints import Outline, outer_radius
from woosh_robot_agent.simulator.world.geometry import Point, Pose, Wall
from woosh_robot_agent.simulator.world.maps import Map
from woosh_robot_agent.simulator.world.obstacles import Obstacles


class Hull:
    """A convex outline, as the half planes of its sides.

    Attributes:
        radius: m from the base's centre to its outermost corner: what is further away than this
            cannot touch, however the base is turned.
        sides: For each side the unit vector that points out of it and its distance in m from the
            base's centre.
    """

    def __init__(self, outline: Outline) -> None:
        self.radius = outer_radius(outline)
        self.sides = tuple(_sides(outline))

    def gap(self, pose: Pose, walls: Iterable[Wall]) -> float:
        """The gap in m between the outline at `pose` and the nearest of `walls`.

        Walls further away than `radius` are left out: infinity means that none is nearer.
        """
        near = (wall for wall in walls if wall.distance(pose.x, pose.y) <= self.radius)
        return min((self._wall_gap(pose, wall) for wall in near), default=math.inf)

    def _wall_gap(self, pose: Pose, wall: Wall) -> float:
        x1, y1 = pose.local(wall.x1, wall.y1)
        x2, y2 = pose.local(wall.x2, wall.y2)
        # Along the wall, each side's distance is a straight line (start, slope) over 0 to 1; the
        # greatest of them is convex. Walk down on it from line to line until it rises.
        lines = [
            (nx * x1 + ny * y1 - distance, nx * (x2 - x1) + ny * (y2 - y1))
            for nx, ny, distance in self.sides
        ]
        share = 0.0
        height, slope = max(lines)
        while slope < 0.0:
            crossings = (
                (max(share, (height - other) / (steeper - slope)), steeper, other)
                for other, steeper in lines
                if steeper > slope
            )
            share, new_slope, new_height = min(crossings, default=(math.inf, 0.0, 0.0))
            if share >= 1.0:
                return height + slope
            height, slope = new_height, new_slope
        return height + slope * share


def _sides(outline: Outline) -> Iterable[tuple[float, float, float]]:
    for (x1, y1), (x2, y2) in pairwise((*outline, outline[0])):
        length = math.hypot(x2 - x1, y2 - y1)
        nx, ny = (y2 - y1) / length, (x1 - x2) / length
        distance = nx * x1 + ny * y1
        # Outlines go either way round; their centre is inside.
        yield (nx, ny, distance) if distance > 0.0 else (-nx, -ny, -distance)


@lru_cache(maxsize=16)
def hull(outline: Outline) -> Hull:
    """The hull of an outline; it is made once."""
    return Hull(outline)


class Bumper:
    """Tells gaps to a base that moves on, without looking round anew while it has room."""

    def __init__(self) -> None:
        self._around: tuple[Map, tuple[Wall, ...]] | None = None
        self._centre: Point = (0.0, 0.0)
        self._room = 0.0

    def gap(self, outline: Outline, pose: Pose, area: Map, obstacles: Obstacles) -> float:
        """The gap in m between the outline at `pose` and walls and obstacles.

        Infinite where nothing is as near as the outline's corners can come.
        """
        shape = hull(outline)
        around = self._around
        if around is None or around[0] is not area or around[1] is not obstacles.walls:
            self._around = (area, obstacles.walls)
            self._room = 0.0
        if self._room - pose.distance(self._centre) > shape.radius:
            return math.inf
        self._centre = pose.point
        self._room = min(area.clearance(*self._centre), obstacles.clearance(*self._centre))
        self._room -= area.blur
        if self._room > shape.radius:
            return math.inf
        return min(area.gap(shape, pose), shape.gap(pose, obstacles.walls))
