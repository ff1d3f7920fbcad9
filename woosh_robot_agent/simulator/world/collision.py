"""Collisions of the base with the walls of the map, and with round obstacles not in the map."""

from __future__ import annotations

import math

from woosh_robot_agent.simulator.world.geometry import Outline, Point, Pose, Wall, hull
from woosh_robot_agent.simulator.world.maps import Map

_CORNERS = 12
"""Number of corners of the polygon that stands for a round obstacle."""


class Obstacles:
    """Obstacles that are not in the map. The laser sees them, and the base cannot pass them.

    Each obstacle is a regular polygon with its corners on a circle. Positions are in the map's
    frame, and do not change when the robot switches to another map.

    Attributes:
        walls: sides of all obstacles: the same object until an obstacle changes.
    """

    def __init__(self) -> None:
        self._circles: dict[str, tuple[float, float, float]] = {}
        """Position of the centre and radius of each obstacle in metres, by name."""
        self._sides: dict[str, tuple[Wall, ...]] = {}
        """Sides of each obstacle, by name."""
        self.walls: tuple[Wall, ...] = ()

    def put(self, name: str, x: float, y: float, radius: float = 0.3) -> None:
        """Add an obstacle, or move and resize the obstacle of the same name.

        Its corners are on the circle with the centre (x, y) and this radius, in metres.

        Raises:
            ValueError: a number is not finite, or the radius is not positive.
        """
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError(f"obstacle {name}: position ({x}, {y}) is not finite")
        if not 0.0 < radius < math.inf:
            raise ValueError(f"obstacle {name}: radius {radius} m is not a positive number")
        self._circles[name] = x, y, radius
        self._sides[name] = _polygon(x, y, radius)
        self._join_sides()

    def remove(self, name: str) -> None:
        """Remove an obstacle; raise KeyError if there is none of this name."""
        del self._circles[name], self._sides[name]
        self._join_sides()

    def clear(self) -> None:
        """Remove all obstacles."""
        self._circles.clear()
        self._sides.clear()
        self._join_sides()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all obstacles, in the order in which they were added."""
        return tuple(self._circles)

    def clearance(self, x: float, y: float) -> float:
        """Return the distance from (x, y) to the nearest obstacle, in metres.

        It is 0 inside the inscribed circle of an obstacle, and infinite without obstacles.
        """
        nearest = math.inf
        for name, (centre_x, centre_y, radius) in self._circles.items():
            distance = math.hypot(x - centre_x, y - centre_y)
            if distance <= radius * math.cos(math.pi / _CORNERS):  # inside the inscribed circle
                return 0.0
            if distance - radius < nearest:  # otherwise no side of it can be nearer
                nearest = min(nearest, *(wall.distance(x, y) for wall in self._sides[name]))
        return nearest

    def _join_sides(self) -> None:
        self.walls = tuple(side for sides in self._sides.values() for side in sides)


def _polygon(x: float, y: float, radius: float) -> tuple[Wall, ...]:
    """Return the sides of a regular polygon whose corners are on a circle (m)."""
    angles = [math.tau * corner / _CORNERS for corner in range(_CORNERS)]
    corners = [(x + radius * math.cos(angle), y + radius * math.sin(angle)) for angle in angles]
    return tuple(
        Wall(*corner, *following)
        for corner, following in zip(corners, corners[1:] + corners[:1], strict=True)
    )


class CollisionDetector:
    """Computes the gaps of a moving base, and skips the computation while nothing is near."""

    def __init__(self) -> None:
        self._area: Map | None = None
        """Map for which the clearance was last computed, None at first."""
        self._obstacle_walls: tuple[Wall, ...] = ()
        """Walls of the obstacles for which the clearance was last computed."""
        self._centre: Point = (0.0, 0.0)
        """Position at which the clearance was last computed, in metres."""
        self._clearance = 0.0
        """Lower limit of the distance from `_centre` to walls and obstacles, in metres."""

    def gap(self, outline: Outline, pose: Pose, area: Map, obstacles: Obstacles) -> float:
        """Return the gap in metres between an outline at `pose` and walls and obstacles.

        The module `geometry` defines gaps. The gap is infinite if nothing is as near to the centre
        as the furthest corner of the outline.
        """
        shape = hull(outline)
        if self._area is not area or self._obstacle_walls is not obstacles.walls:
            self._area, self._obstacle_walls = area, obstacles.walls
            self._clearance = 0.0  # not known
        if self._clearance - pose.distance(self._centre) > shape.radius:
            return math.inf  # since then, the base has not moved far enough to be near anything
        self._centre = pose.point
        clearance = min(area.clearance(*self._centre), obstacles.clearance(*self._centre))
        self._clearance = clearance - area.clearance_error
        if self._clearance > shape.radius:
            return math.inf
        return min(area.gap(shape, pose), shape.gap(pose, obstacles.walls))
