"""The safety laser: rays cast against walls and, where the map is a picture, against its cells."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from woosh_robot_agent.simulator.world.geometry import Pose, Wall, wrap

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.world.grid import Grid


@dataclass(frozen=True)
class Laser:
    """A laser on the base.

    Attributes:
        forward: How far in front of the base's centre it sits, in m.
        angle_min: The first ray's angle from straight ahead, in rad.
        angle_max: The last ray's.
        increment: Between two rays, in rad.
        range_min: m.
        range_max: m; a ray that hits nothing within it reads infinity.
        scan_time: From one scan to the next, in s.
        noise: Standard deviation of a range, in m.
    """

    forward: float = 0.25
    angle_min: float = -2.2
    angle_max: float = 2.2
    increment: float = 0.005
    range_min: float = 0.05
    range_max: float = 25.0
    scan_time: float = 0.05
    noise: float = 0.003

    @property
    def rays(self) -> int:
        """How many rays one scan has."""
        return round((self.angle_max - self.angle_min) / self.increment) + 1

    def scan(
        self, base: Pose, walls: Sequence[Wall], rng: random.Random, grid: Grid | None = None
    ) -> list[float]:
        """The ranges in m that a base standing at `base` measures, first ray first."""
        origin = base.moved(self.forward, 0.0, 0.0)
        if grid:
            first = origin.theta + self.angle_min
            ranges = grid.cast(origin.point, first, self.increment, self.rays, self.range_max)
        else:
            ranges = [math.inf] * self.rays
        for wall in walls:
            self._cast(origin, wall, ranges)
        return [
            max(self.range_min, range_ + max(-0.01, min(0.01, rng.gauss(0.0, self.noise))))
            if range_ <= self.range_max
            else math.inf
            for range_ in ranges
        ]

    def _cast(self, origin: Pose, wall: Wall, ranges: list[float]) -> None:
        """Shorten the rays that hit `wall`."""
        x1, y1 = wall.x1 - origin.x, wall.y1 - origin.y
        x2, y2 = wall.x2 - origin.x, wall.y2 - origin.y
        if x1 * y2 - x2 * y1 < 0.0:
            x1, y1, x2, y2 = x2, y2, x1, y1
        # The wall now runs counter-clockwise: its rays are those from `start` over `sweep`.
        area = x1 * y2 - x2 * y1
        if area == 0.0:
            return
        start = wrap(math.atan2(y1, x1) - origin.theta)
        sweep = wrap(math.atan2(y2, x2) - math.atan2(y1, x1))
        along_x, along_y = x2 - x1, y2 - y1
        # A wall that spans the blind sector behind the robot comes back in at the other side.
        for begin in (start, start - math.tau):
            first = max(0, math.ceil((begin - self.angle_min) / self.increment))
            last = min(self.rays - 1, math.floor((begin + sweep - self.angle_min) / self.increment))
            for ray in range(first, last + 1):
                angle = origin.theta + self.angle_min + ray * self.increment
                across = math.cos(angle) * along_y - math.sin(angle) * along_x
                if across > 0.0:
                    ranges[ray] = min(ranges[ray], area / across)
