"""Obstacles: round things that stand on the floor without being in the map, and can go again."""

from __future__ import annotations

import math

from woosh_robot_agent.simulator.world.geometry import Wall

_CORNERS = 12


class Obstacles:
    """What stands in the way besides the map's walls; the laser sees it, the base cannot pass it.

    Each is a regular polygon with its corners on a circle: round to a laser, and made of walls like
    everything else. Positions are in the map's frame, and stay when the map is switched.
    """

    def __init__(self) -> None:
        self._circles: dict[str, tuple[float, float, float]] = {}
        self._walls: dict[str, tuple[Wall, ...]] = {}
        self._all: tuple[Wall, ...] = ()

    def put(self, name: str, x: float, y: float, radius: float = 0.3) -> None:
        """Put an obstacle somewhere, in place of the one of the same name.

        Args:
            name: By which it can be moved and removed.
            x: m.
            y: m.
            radius: m.

        Raises:
            ValueError: A number is not finite, or the radius is not positive.
        """
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError(f"obstacle {name}: position ({x}, {y}) is not finite")
        if not 0.0 < radius < math.inf:
            raise ValueError(f"obstacle {name}: radius {radius} m is not a positive number")
        self._circles[name] = x, y, radius
        self._walls[name] = _polygon(x, y, radius)
        self._all = self._joined()

    def remove(self, name: str) -> None:
        """Take an obstacle away.

        Raises:
            KeyError: There is none of this name.
        """
        del self._circles[name], self._walls[name]
        self._all = self._joined()

    def clear(self) -> None:
        """Take all away."""
        self._circles.clear()
        self._walls.clear()
        self._all = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all, in the order in which they came."""
        return tuple(self._circles)

    @property
    def walls(self) -> tuple[Wall, ...]:
        """The sides of all; the same object until one comes, moves or goes."""
        return self._all

    def clearance(self, x: float, y: float) -> float:
        """How far the nearest obstacle is from (x, y), in m: 0 inside of one, infinite if none."""
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
