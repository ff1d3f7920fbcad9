"""What a scene is made of: maps with walls and marks."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.simulator.world.geometry import Point, Pose, Wall

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.world.collision import Hull
    from woosh_robot_agent.simulator.world.grid import Grid


class MarkKind(Enum):
    """What stands at a mark; the value is its group in `woosh.map.mark.Storages`."""

    BASE = "bases"
    RACK = "racks"
    PARKSPOT = "parkspots"
    CHARGER = "chargers"
    PALLET_PLATFORM = "pallet_platforms"
    LIFT_TROLLEY = "lift_trolleys"
    TRACTOR_TRAILER = "tractor_trailers"
    ROLLER_STATION = "roller_stations"
    ARM_WORKTOP = "arm_worktops"


@dataclass(frozen=True)
class Mark:
    """A place with a number that a task can name.

    Attributes:
        id: Unique in its map.
        number: The number by which tasks name it, any string.
        pose: Where a robot stands when it is there, in the map's frame.
        kind: What stands there.
        description: For people.
    """

    id: int
    number: str
    pose: Pose
    kind: MarkKind = MarkKind.BASE
    description: str = ""


@dataclass(frozen=True, eq=False)
class Map:
    """One floor.

    Attributes:
        id: Unique in its scene.
        name: Unique in its scene.
        floor: The floor's name.
        version: Counts the map's changes.
        low: The corner of the mapped area with the smallest x and y, in m.
        high: The opposite corner, in m.
        walls: What a laser sees and a robot must not touch, as lines.
        marks: The marks, by number.
        grid: The same as a picture; a map can have both.
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

    def clearance(self, x: float, y: float) -> float:
        """How far the nearest wall or occupied cell is from (x, y), in m."""
        nearest = min((wall.distance(x, y) for wall in self.walls), default=math.inf)
        return min(nearest, self.grid.clearance(x, y)) if self.grid else nearest

    @property
    def blur(self) -> float:
        """By how many m `clearance` may be too great."""
        return self.grid.resolution if self.grid else 0.0

    def gap(self, hull: Hull, pose: Pose) -> float:
        """How far in m an outline at `pose` is from touching something: see `collision`."""
        gap = hull.gap(pose, self.walls)
        return min(gap, self.grid.gap(hull, pose)) if self.grid else gap

    def contains(self, x: float, y: float) -> bool:
        """Whether (x, y) lies in the mapped area."""
        if not (self.low[0] <= x <= self.high[0] and self.low[1] <= y <= self.high[1]):
            return False
        return self.grid is None or self.grid.known(x, y)


@dataclass
class Scene:
    """A place of work.

    Attributes:
        name: Unique.
        maps: At least one; the first is used where none is named.
        files: What clients uploaded for it, by name.
        start: Where a robot stands at first, on `start_map`; None if the scene does not say.
        start_map: The map on which it stands.
        predefined: The task sets that ExecPreTask can start.
        calls: The task sets that call buttons start.
    """

    name: str
    maps: list[Map]
    files: dict[str, bytes] = field(default_factory=dict)
    start: Pose | None = None
    start_map: str = ""
    predefined: woosh_task_pb2.RepeatTasks = field(default_factory=woosh_task_pb2.RepeatTasks)
    calls: woosh_task_pb2.CallTasks = field(default_factory=woosh_task_pb2.CallTasks)

    def map(self, name: str) -> Map | None:
        """The map called `name`, or the first one if `name` is empty."""
        if not name:
            return self.maps[0]
        return next((each for each in self.maps if each.name == name), None)
