"""Paths through a map's free floor: A* on a lattice, then straightened."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache, partial

from woosh_robot_agent.simulator.world.geometry import Point, Wall
from woosh_robot_agent.simulator.world.maps import Map

_CELL_M = 0.2
#: A cell this near to an end of the path, and in sight of it, is as good as that end.
_REACH_M = 0.6
#: What has to stay free even around a start that is closer to something than the radius, in m.
_LEAST_M = 1e-3
#: A second or so on an ordinary machine, enough to search all of 100 x 100 m.
MOST_EFFORT = 300_000
#: What a look along a line costs, and how many walls or points of it cost one unit more.
_LOOK_EFFORT, _WALLS_PER_UNIT, _POINTS_PER_UNIT = 4, 16, 32
#: What the side of an obstacle costs.
_OBSTACLE_EFFORT = 20
#: By how much a diagonal step is longer than a straight one, as a share of that.
_DIAGONAL = math.sqrt(2.0) - 1.0


class TooMuchEffortError(Exception):
    """A way was not found with the effort that its planning may take."""


class Effort:
    """What the planning of one way may still cost: everything else waits for it.

    Args:
        units: Each is what a search takes for one place, some microseconds.
    """

    def __init__(self, units: int = MOST_EFFORT) -> None:
        self._left = units

    def spend(self, units: int) -> None:
        """Use some of it up.

        Raises:
            TooMuchEffortError: There is less than that.
        """
        self._left -= units
        if self._left < 0:
            raise TooMuchEffortError


class Lattice:
    """The places of a map that a search steps through, in rows from its lower left corner on.

    They are numbered row by row, with a border of blocked ones that keeps a search inside.
    """

    def __init__(self, area: Map) -> None:
        (left, bottom), (right, top) = area.low, area.high
        self._low = area.low
        self._columns = math.floor((right - left) / _CELL_M + 1e-6)
        self._rows = math.floor((top - bottom) / _CELL_M + 1e-6)
        self._width = self._columns + 2
        # The differences to the numbers of the neighbours, and how far those are in m.
        self._steps = tuple(
            (dx + dy * self._width, _CELL_M * math.hypot(dx, dy))
            for dx in (-1, 0, 1)
            for dy in (-1, 0, 1)
            if (dx, dy) != (0, 0)
        )

    def blocked(self, area: Map, radius: float) -> bytearray:
        """For each place whether the map has something nearer to it than `radius` (m)."""
        rows: Iterable[bytes] = [bytes(self._columns)] * self._rows
        if area.grid:
            first = self._low[0] + 0.5 * _CELL_M, self._low[1] + 0.5 * _CELL_M
            rows = area.grid.cramped(first, _CELL_M, self._columns, self._rows, radius)
        border = b"\1" * self._width
        places = bytearray(b"".join((border, *(b"\1" + row + b"\1" for row in rows), border)))
        self.block(places, area.walls, radius)
        return places

    def block(self, places: bytearray, walls: Iterable[Wall], radius: float) -> None:
        """Block the places that are nearer to one of `walls` than `radius` (m)."""
        for wall in walls:
            reach = (
                min(wall.x1, wall.x2) - radius,
                min(wall.y1, wall.y2) - radius,
                max(wall.x1, wall.x2) + radius,
                max(wall.y1, wall.y2) + radius,
            )
            for place in self._within(*reach):
                if not places[place] and wall.distance(*self.centre(place)) < radius:
                    places[place] = 1

    def around(self, point: Point) -> Iterator[tuple[int, Point]]:
        """The places within reach of a point, with their middles."""
        x, y = point
        for place in self._within(x - _REACH_M, y - _REACH_M, x + _REACH_M, y + _REACH_M):
            centre = self.centre(place)
            if math.dist(centre, point) <= _REACH_M:
                yield place, centre

    def search(
        self,
        first: dict[int, float],
        last: set[int],
        goal: Point,
        blocked: bytearray,
        effort: Effort,
    ) -> list[int] | None:
        """The shortest way from a place to another by A*, or None if there is none.

        Args:
            first: Where it can start, and how far in m it was to get there.
            last: Where it can end.
            goal: Where it is to go from there.
            blocked: The places that it cannot pass, as from `blocked`.
            effort: What it may cost.

        Raises:
            TooMuchEffortError: There may be a way, but further off.
        """
        width, steps = self._width, self._steps
        goal_column = (goal[0] - self._low[0]) / _CELL_M + 0.5
        goal_row = (goal[1] - self._low[1]) / _CELL_M + 0.5

        def to_go(place: int) -> float:
            """The length of the shortest way in straight and diagonal steps."""
            row, column = divmod(place, width)
            along, across = abs(goal_column - column), abs(goal_row - row)
            if along < across:
                along, across = across, along
            return _CELL_M * (along + _DIAGONAL * across)

        costs = dict(first)
        frontier = [(cost + to_go(place), cost, place) for place, cost in first.items()]
        heapq.heapify(frontier)
        came_from: dict[int, int] = {}
        while frontier:
            _, cost, place = heapq.heappop(frontier)
            if cost > costs[place]:
                continue
            effort.spend(1)
            if place in last:
                path = [place]
                while path[-1] in came_from:
                    path.append(came_from[path[-1]])
                return path[::-1]
            for step, length in steps:
                other = place + step
                if blocked[other]:
                    continue
                new_cost = cost + length
                if new_cost < costs.get(other, math.inf):
                    costs[other] = new_cost
                    came_from[other] = place
                    heapq.heappush(frontier, (new_cost + to_go(other), new_cost, other))
        return None

    def centre(self, place: int) -> Point:
        """The middle of a place, in m."""
        row, column = divmod(place, self._width)
        return self._low[0] + (column - 0.5) * _CELL_M, self._low[1] + (row - 0.5) * _CELL_M

    def _within(self, left: float, bottom: float, right: float, top: float) -> Iterator[int]:
        columns = self._span(left - self._low[0], right - self._low[0], self._columns)
        for row in self._span(bottom - self._low[1], top - self._low[1], self._rows):
            for column in columns:
                yield (row + 1) * self._width + column + 1

    @staticmethod
    def _span(low: float, high: float, count: int) -> range:
        return range(max(0, math.floor(low / _CELL_M)), min(count, math.floor(high / _CELL_M) + 1))


class Planner:
    """Plans on one map for a robot that keeps `radius` (m) away from whatever is not free."""

    def __init__(self, area: Map, radius: float) -> None:
        self._map = area
        self._radius = radius
        self._lattice = Lattice(area)
        self._blocked = self._lattice.blocked(area, radius)

    def plan(
        self,
        start: Point,
        goal: Point,
        obstacles: Sequence[Wall] = (),
        effort: Effort | None = None,
    ) -> list[Point] | None:
        """The corners of a free path, or None if there is none.

        Args:
            start: Where it starts, in m; it is not one of the corners.
            goal: Where it ends, in m; it is the last corner.
            obstacles: Walls to keep away from besides what the map has.
            effort: What it may cost; several legs of a way share one.

        Raises:
            TooMuchEffortError: It would cost more.
        """
        effort = effort or Effort()
        walls = (*self._map.walls, *obstacles)

        def free(here: Point, there: Point, radius: float) -> bool:
            points = 0
            if self._map.grid:
                points = int(math.dist(here, there) / self._map.grid.resolution)
            effort.spend(_LOOK_EFFORT + len(walls) // _WALLS_PER_UNIT + points // _POINTS_PER_UNIT)
            return self._free(here, there, radius, walls)

        if not (self._map.contains(*goal) and free(goal, goal, self._radius)):
            return None
        # A robot that was driven closer to something than it would plan may leave from there.
        leaving = self._leaving(start, walls)
        if leaving < _LEAST_M:
            return None
        if free(start, goal, leaving):
            return [goal]
        blocked = self._blocked
        if obstacles:
            blocked = blocked.copy()
            effort.spend(_OBSTACLE_EFFORT * len(obstacles))
            self._lattice.block(blocked, obstacles, self._radius)
        first = {
            place: math.dist(start, there)
            for place, there in self._lattice.around(start)
            if not blocked[place] and free(start, there, leaving)
        }
        last = {
            place
            for place, there in self._lattice.around(goal)
            if not blocked[place] and free(goal, there, self._radius)
        }
        places = self._lattice.search(first, last, goal, blocked, effort)
        if places is None:
            return None
        corners = [start, *map(self._lattice.centre, places), goal]

        def in_sight(here: int, there: int) -> bool:
            return free(corners[here], corners[there], self._radius if here else leaving)

        path: list[Point] = []
        here = 0
        while here < len(corners) - 1:
            here = _furthest(here + 1, len(corners) - 1, partial(in_sight, here))
            path.append(corners[here])
        return path

    def _leaving(self, start: Point, walls: Sequence[Wall]) -> float:
        """How far in m a path can keep away from things at its start."""
        room = min((wall.distance(*start) for wall in walls), default=self._radius)
        if self._map.grid:
            room = min(room, self._map.grid.line_room(start, start))
        return min(self._radius, room - 1e-6)

    def _free(self, start: Point, end: Point, radius: float, walls: Sequence[Wall]) -> bool:
        """Whether nothing is nearer to the line from `start` to `end` than `radius` (m)."""
        left, right = min(start[0], end[0]) - radius, max(start[0], end[0]) + radius
        bottom, top = min(start[1], end[1]) - radius, max(start[1], end[1]) + radius
        for wall in walls:
            # Most walls are far off, which is quickly seen.
            if (
                (wall.x1 > left or wall.x2 > left)
                and (wall.x1 < right or wall.x2 < right)
                and (wall.y1 > bottom or wall.y2 > bottom)
                and (wall.y1 < top or wall.y2 < top)
                and wall.line_distance(start, end) < radius
            ):
                return False
        return self._map.grid is None or self._map.grid.line_room(start, end) >= radius


def _furthest(good: int, last: int, fits: Callable[[int], bool]) -> int:
    """The last number up to `last` that fits if all before it do, by ever wider steps, then halves.

    Where they don't, it is another one that fits; `good` is taken to fit.
    """
    step = 1
    bad = last + 1
    while good < last:
        there = min(good + step, last)
        if not fits(there):
            bad = there
            break
        good = there
        step *= 2
    while bad - good > 1:
        middle = (good + bad) // 2
        if fits(middle):
            good = middle
        else:
            bad = middle
    return good


@lru_cache(maxsize=16)
def planner(area: Map, radius: float) -> Planner:
    """The planner for a map and a radius (m); its lattice is made once."""
    return Planner(area, radius)
