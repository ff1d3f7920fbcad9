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
    """

    def __init__(self) -> None:
        self._circles: dict[str, tuple[float, float, float]] = {}
        self._walls: dict[str, tuple[Wall, ...]] = {}
        self._all: tuple[Wall, ...] = ()

    def put(self, name: str, x: float, y: float, radius: float = 0.3) -> None:
        """Add an obstacle, or move and resize the obstacle of the same name.

        Args:
            name: name by which the obstacle can be moved and removed.
            x: position of the centre, in metres.
            y: position of the centre, in metres.
            radius: radius, in metres.

        Raises:
            ValueError: a number is not finite, or the radius is not positive.
        """
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError(f"obstacle {name}: position ({x}, {y}) is not finite")
        if not 0.0 < radius < math.inf:
            raise ValueError(f"obstacle {name}: radius {radius} m is not a positive number")
        self._circles[name] = x, y, radius
        self._walls[name] = _polygon(x, y, radius)
        self._all = self._joined()

    def remove(self, name: str) -> None:
        """Remove an obstacle.

        Raises:
            KeyError: there is no obstacle of this name.
        """
        del self._circles[name], self._walls[name]
        self._all = self._joined()

    def clear(self) -> None:
        """Remove all obstacles."""
        self._circles.clear()
        self._walls.clear()
        self._all = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all obstacles, in the order in which they were added."""
        return tuple(self._circles)

    @property
    def walls(self) -> tuple[Wall, ...]:
        """Sides of all obstacles; the same tuple object as long as no obstacle changes."""
        return self._all

    def clearance(self, x: float, y: float) -> float:
        """Return the distance from (x, y) to the nearest obstacle, in metres.

        It is 0 inside an obstacle, and infinite without obstacles.
        """
        nearest = math.inf
        for name, (centre_x, centre_y, radius) in self._circles.items():
            distance = math.hypot(x - centre_x, y - centre_y)
            if distance <= radius * math.cos(math.pi / _CORNERS):
                return 0.0
            if distance - radius < nearest:
                nearest = min(nearest, *(wall.distance(x, y) for wall in self._walls[name]))
        return nearest

    def _joined(self) -> tuple[Wall, ...]:
        return tuple(wall for walls in self._walls.values() for wall in walls)


def _polygon(x: float, y: float, radius: float) -> tuple[Wall, ...]:
    angles = [math.tau * corner / _CORNERS for corner in range(_CORNERS)]
    corners = [(x + radius * math.cos(angle), y + radius * math.sin(angle)) for angle in angles]
    return tuple(
        Wall(*corner, *following)
        for corner, following in zip(corners, corners[1:] + corners[:1], strict=True)
    )


class CollisionDetector:
    """Computes gaps for a moving base, and skips the computation while nothing is near."""

    def __init__(self) -> None:
        self._surroundings: tuple[Map, tuple[Wall, ...]] | None = None
        self._centre: Point = (0.0, 0.0)
        """Position at which the clearance was last computed, in metres."""
        self._clearance = 0.0
        """Clearance at `_centre`, in metres."""

    def gap(self, outline: Outline, pose: Pose, area: Map, obstacles: Obstacles) -> float:
        """Return the gap in metres between the outline at `pose` and walls and obstacles.

        The module `geometry` defines the gap. It is infinite if nothing is within the outline's
        radius.
        """
        shape = hull(outline)
        known = self._surroundings
        if known is None or known[0] is not area or known[1] is not obstacles.walls:
            self._surroundings = (area, obstacles.walls)
            self._clearance = 0.0
        if self._clearance - pose.distance(self._centre) > shape.radius:
            return math.inf
        self._centre = pose.point
        self._clearance = min(area.clearance(*self._centre), obstacles.clearance(*self._centre))
        self._clearance -= area.clearance_error
        if self._clearance > shape.radius:
            return math.inf
        return min(area.gap(shape, pose), shape.gap(pose, obstacles.walls))
