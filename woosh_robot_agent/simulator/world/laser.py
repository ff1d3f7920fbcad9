"""The safety laser: rays cast against walls, obstacles and the cells of an occupancy grid."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from woosh_robot_agent.simulator.world.geometry import Pose, Wall, wrap

if TYPE_CHECKING:  # numpy and scipy load slowly, and few maps have a grid
    from woosh_robot_agent.simulator.world.grid import Grid

_MAX_RAYS = 10_000
"""Maximum number of rays of a scan."""

_MAX_ERROR = 0.01
"""Maximum error of a range, in metres.

Because errors are limited, `growing_grid` can put all echoes of a wall into the same cell.
"""


@dataclass(frozen=True)
class Laser:
    """A laser on the base.

    Attributes:
        forward: distance in front of the centre of the base, in metres.
        angle_min: angle of the first ray, counter-clockwise from straight ahead, in radians.
        angle_max: angle of the last ray, likewise.
        increment: angle between two rays, in radians.
        range_min: minimum range, in metres. Nearer echoes also have this range.
        range_max: maximum range, in metres. A ray that hits nothing within it measures infinity.
        scan_time: time between two scans as ScannerData reports it, in seconds. The simulated scans
            have the period that the profile gives.
        noise: standard deviation of a range, in metres.
    """

    forward: float = 0.25
    angle_min: float = -2.2
    angle_max: float = 2.2
    increment: float = 0.005
    range_min: float = 0.05
    range_max: float = 25.0
    scan_time: float = 0.05
    noise: float = 0.003

    def __post_init__(self) -> None:
        if self.increment <= 0.0 or not 1 <= self.rays <= _MAX_RAYS:
            raise ValueError(
                f"a scan from angle_min to angle_max in steps of increment must have 1 to "
                f"{_MAX_RAYS} rays"
            )
        if not 0.0 <= self.range_min < self.range_max:
            raise ValueError("range_min must be at least 0 and less than range_max")

    @property
    def rays(self) -> int:
        """Number of rays of a scan."""
        return round((self.angle_max - self.angle_min) / self.increment) + 1

    def scan(
        self, base: Pose, walls: Sequence[Wall], rng: random.Random, grid: Grid | None = None
    ) -> list[float]:
        """Return the ranges of a scan in metres, first ray first; infinite for a ray without echo.

        Args:
            base: pose of the base in the map's frame.
            walls: walls, including the sides of obstacles.
            rng: random number generator for the noise.
            grid: occupancy grid that the rays also hit; None if there is none.
        """
        origin = base.moved(self.forward, 0.0, 0.0)
        if grid:
            first = origin.theta + self.angle_min
            ranges = grid.cast(origin.point, first, self.increment, self.rays, self.range_max)
        else:
            ranges = [math.inf] * self.rays
        for wall in walls:
            self._cast(origin, wall, ranges)
        return [self._measure(distance, rng) for distance in ranges]

    def _measure(self, distance: float, rng: random.Random) -> float:
        """Return the range that is measured at a distance (m); infinite beyond `range_max`."""
        if distance > self.range_max:
            return math.inf
        error = max(-_MAX_ERROR, min(_MAX_ERROR, rng.gauss(0.0, self.noise)))
        return min(self.range_max, max(self.range_min, distance + error))

    def _cast(self, origin: Pose, wall: Wall, ranges: list[float]) -> None:
        """Shorten the `ranges` of the rays from `origin` that hit `wall`, in place."""
        x1, y1 = wall.x1 - origin.x, wall.y1 - origin.y
        x2, y2 = wall.x2 - origin.x, wall.y2 - origin.y
        if x1 * y2 - x2 * y1 < 0.0:
            x1, y1, x2, y2 = x2, y2, x1, y1
        # The wall now runs counter-clockwise, so its rays span `sweep` radians from `start` on.
        cross = x1 * y2 - x2 * y1
        if cross == 0.0:  # seen edge-on
            return
        start = wrap(math.atan2(y1, x1) - origin.theta)
        sweep = wrap(math.atan2(y2, x2) - math.atan2(y1, x1))
        along_x, along_y = x2 - x1, y2 - y1
        # The angles of a scan may exceed half a turn, and both of its ends may see the same wall.
        for begin in (start - math.tau, start, start + math.tau):
            first = max(0, math.ceil((begin - self.angle_min) / self.increment))
            last = min(self.rays - 1, math.floor((begin + sweep - self.angle_min) / self.increment))
            for ray in range(first, last + 1):
                angle = origin.theta + self.angle_min + ray * self.increment
                across = math.cos(angle) * along_y - math.sin(angle) * along_x
                if across > 0.0:  # the ray meets the line of the wall, at `cross / across` metres
                    ranges[ray] = min(ranges[ray], cross / across)
