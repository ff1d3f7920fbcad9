"""Convex outlines, and the gap between an outline and walls.

The gap is the distance by which each side of the outline could be moved outwards before it touches
something. A negative gap is the depth to which something has entered the outline. The gap grows on
the way out of a collision, which lets a base leave one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from itertools import pairwise

from woosh_robot_agent.simulator.world.footprints import Outline, outer_radius
from woosh_robot_agent.simulator.world.geometry import Pose, Wall


class Hull:
    """A convex outline, as the half planes of its sides.

    Attributes:
        radius: Distance from the centre of the base to the outermost corner, in metres. Anything
            further away cannot touch the outline at any heading.
        sides: For each side the unit normal (x, y) that points outwards, and the distance of the
            side from the centre of the base in metres.
    """

    def __init__(self, outline: Outline) -> None:
        self.radius = outer_radius(outline)
        self.sides = tuple(_sides(outline))

    def gap(self, pose: Pose, walls: Iterable[Wall]) -> float:
        """Return the gap in metres between the outline at `pose` and the nearest wall.

        The gap is infinite if all walls are further away than `radius`.
        """
        near = (wall for wall in walls if wall.distance(pose.x, pose.y) <= self.radius)
        return min((self._wall_gap(pose, wall) for wall in near), default=math.inf)

    def _wall_gap(self, pose: Pose, wall: Wall) -> float:
        x1, y1 = pose.local(wall.x1, wall.y1)
        x2, y2 = pose.local(wall.x2, wall.y2)
        # Along the wall, the distance to each side is linear: a value at the start and a slope.
        # The maximum of these lines is convex. Follow it from line to line to its minimum.
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
        # An outline may be clockwise or counter-clockwise, but it encloses the centre.
        yield (nx, ny, distance) if distance > 0.0 else (-nx, -ny, -distance)


@lru_cache(maxsize=16)
def hull(outline: Outline) -> Hull:
    """Return the hull of an outline, computed once."""
    return Hull(outline)
