"""Maps with walls, marks and occupancy grids; and obstacles, which are on no map."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from typing import TYPE_CHECKING

from woosh_robot_agent.pb.map import mark_pb2
from woosh_robot_agent.simulator.world.geometry import Hull, Point, Pose, Wall

if TYPE_CHECKING:  # numpy and scipy load slowly, and few maps have a grid
    from woosh_robot_agent.simulator.world.grid import Grid


class MarkKind(Enum):
    """Kind of a mark, named like its category in `woosh.map.mark.Storage`; BASE has no category."""

    BASE = "base"
    RACK = "rack"
    PARKSPOT = "parkspot"
    CHARGER = "charger"
    PALLET_PLATFORM = "pallet_platform"
    LIFT_TROLLEY = "lift_trolley"
    TRACTOR_TRAILER = "tractor_trailer"
    ROLLER_STATION = "roller_station"
    ARM_WORKTOP = "arm_worktop"


@dataclass(frozen=True)
class Mark:
    """A numbered place that a task can name as its target.

    Attributes:
        id: identifier, unique in its map.
        number: number by which tasks name the mark; any string.
        pose: pose of a robot that stands at the mark, in the map's frame.
        storage: all data of the mark, if they came as a message; else None.
    """

    id: int
    number: str
    pose: Pose
    kind: MarkKind = MarkKind.BASE
    description: str = ""
    storage: mark_pb2.Storage | None = field(default=None, compare=False)


@dataclass(frozen=True, eq=False)
class Map:
    """The map of one floor.

    Attributes:
        id: identifier, unique in its scene.
        name: name, unique in its scene.
        floor: name of the floor.
        version: number that each change increases.
        low: corner of the mapped area with the smallest x and y, in metres.
        high: opposite corner, in metres.
        walls: walls, which the laser sees and the robot cannot pass.
        marks: marks, by number.
        grid: occupancy grid, used in addition to the walls; None if there is none.
        other_marks: marks of other kinds, such as beacons, which the robot only stores.
        end: pose of the robot when it was last on the map, or at the end of its mapping; None if
            it is not known.
        ground_truth: for a map that the robot made: the map with the real walls, which decide on
            collisions and scans. None for a map that has the real walls itself.
    """

    id: int
    name: str
    floor: str
    version: int
    low: Point
    high: Point
    walls: tuple[Wall, ...]
    marks: dict[str, Mark] = field(default_factory=dict)
    grid: Grid | None = None
    other_marks: mark_pb2.MarkInfo = field(default_factory=mark_pb2.MarkInfo)
    end: Pose | None = None
    ground_truth: Map | None = None

    def clearance(self, x: float, y: float) -> float:
        """Return the distance from (x, y) to the nearest wall or occupied cell, in metres.

        It is infinite if there is none, and exact to within a cell.
        """
        nearest = min((wall.distance(x, y) for wall in self.walls), default=math.inf)
        return min(nearest, self.grid.clearance(x, y)) if self.grid else nearest

    def same_ground(self, other: Map) -> bool:
        """Return True if another map has the same area and walls and the same `Grid` object."""
        mine, others = (self.low, self.high, self.walls), (other.low, other.high, other.walls)
        return mine == others and self.grid is other.grid

    def gap(self, hull: Hull, pose: Pose) -> float:
        """Return the gap in metres between an outline at `pose` and walls and occupied cells.

        It is negative if they overlap, and infinite if no wall or occupied cell is near.
        """
        gap = hull.gap(pose, self.walls)
        return min(gap, self.grid.gap(hull, pose)) if self.grid else gap

    def contains(self, x: float, y: float) -> bool:
        """Return True if (x, y) is in the mapped area, and not in an unknown cell."""
        if not (self.low[0] <= x <= self.high[0] and self.low[1] <= y <= self.high[1]):
            return False
        return self.grid is None or self.grid.known(x, y)


_CORNERS = 12
"""Number of corners of the polygon that stands for a round obstacle."""


class Obstacles:
    """Obstacles that are not in the map. The laser sees them, and the base cannot pass them.

    Each obstacle is a regular polygon with its corners on a circle. Positions are in the map's
    frame, and do not change when the robot switches to another map.
    """

    def __init__(self) -> None:
        self._sides: dict[str, tuple[Wall, ...]] = {}
        """Sides of each obstacle, by name."""

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
        angles = [math.tau * corner / _CORNERS for corner in range(_CORNERS)]
        corners = [(x + radius * math.cos(angle), y + radius * math.sin(angle)) for angle in angles]
        sides = pairwise((*corners, corners[0]))
        self._sides[name] = tuple(Wall(*start, *end) for start, end in sides)

    def remove(self, name: str) -> None:
        """Remove an obstacle; raise KeyError if there is none of this name."""
        del self._sides[name]

    def clear(self) -> None:
        """Remove all obstacles."""
        self._sides.clear()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all obstacles, in the order in which they were added."""
        return tuple(self._sides)

    @property
    def walls(self) -> tuple[Wall, ...]:
        """Sides of all obstacles."""
        return tuple(side for sides in self._sides.values() for side in sides)
