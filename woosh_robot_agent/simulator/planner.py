"""Paths through a map's free floor: A* on a grid, then straightened."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from functools import lru_cache

from woosh_robot_agent.simulator.geometry import Point, Wall
from woosh_robot_agent.simulator.maps import Map

_CELL_M = 0.2
#: A cell this near to an end of the path, and in sight of it, is as good as that end.
_REACH_M = 0.6

Cell = tuple[int, int]

_NEIGHBOURS = tuple(
    (dx, dy, _CELL_M * math.hypot(dx, dy))
    for dx in (-1, 0, 1)
    for dy in (-1, 0, 1)
    if (dx, dy) != (0, 0)
)


class Planner:
    """Plans on one map for a robot that keeps `radius` (m) away from walls."""

    def __init__(self, area: Map, radius: float) -> None:
        self._map = area
        self._radius = radius
        self._columns = int((area.high[0] - area.low[0]) / _CELL_M)
        self._rows = int((area.high[1] - area.low[1]) / _CELL_M)
        self._occupied = {cell for wall in area.walls for cell in self._cells_near(wall)}

    def plan(self, start: Point, goal: Point) -> list[Point] | None:
        """The corners of a free path from `start` (not included) to `goal`, or None."""
        if not self._map.contains(*goal) or self._map.clearance(*goal) < self._radius:
            return None
        # A robot that was driven closer to a wall than it would plan may leave from there.
        leaving = min(self._radius, self._map.clearance(*start)) - 1e-6
        if self._free(start, goal, leaving):
            return [goal]
        cells = self._search(start, goal, leaving)
        if cells is None:
            return None
        return self._straightened([start, *map(self._centre, cells), goal], leaving)

    def _search(self, start: Point, goal: Point, leaving: float) -> list[Cell] | None:
        frontier: list[tuple[float, float, Cell]] = []
        costs: dict[Cell, float] = {}
        came_from: dict[Cell, Cell] = {}
        for cell in self._cells_around(start):
            centre = self._centre(cell)
            if self._free(start, centre, leaving):
                costs[cell] = math.dist(start, centre)
                heapq.heappush(frontier, (costs[cell] + math.dist(centre, goal), costs[cell], cell))
        while frontier:
            _, cost, cell = heapq.heappop(frontier)
            if cost > costs[cell]:
                continue
            centre = self._centre(cell)
            if math.dist(centre, goal) <= _REACH_M and self._free(centre, goal, self._radius):
                path = [cell]
                while path[-1] in came_from:
                    path.append(came_from[path[-1]])
                return path[::-1]
            for dx, dy, length in _NEIGHBOURS:
                other = (cell[0] + dx, cell[1] + dy)
                new_cost = cost + length
                if self._is_free(other) and new_cost < costs.get(other, math.inf):
                    costs[other] = new_cost
                    came_from[other] = cell
                    estimate = new_cost + math.dist(self._centre(other), goal)
                    heapq.heappush(frontier, (estimate, new_cost, other))
        return None

    def _straightened(self, corners: list[Point], leaving: float) -> list[Point]:
        path: list[Point] = []
        here = 0
        while here < len(corners) - 1:
            radius = self._radius if here else leaving
            there = len(corners) - 1
            while there > here + 1 and not self._free(corners[here], corners[there], radius):
                there -= 1
            path.append(corners[there])
            here = there
        return path

    def _free(self, start: Point, end: Point, radius: float) -> bool:
        return all(wall.line_distance(start, end) >= radius for wall in self._map.walls)

    def _is_free(self, cell: Cell) -> bool:
        inside = 0 <= cell[0] < self._columns and 0 <= cell[1] < self._rows
        return inside and cell not in self._occupied

    def _centre(self, cell: Cell) -> Point:
        low = self._map.low
        return low[0] + (cell[0] + 0.5) * _CELL_M, low[1] + (cell[1] + 0.5) * _CELL_M

    def _cells_around(self, point: Point) -> Iterator[Cell]:
        column = int((point[0] - self._map.low[0]) // _CELL_M)
        row = int((point[1] - self._map.low[1]) // _CELL_M)
        reach = int(_REACH_M / _CELL_M)
        for cell in (
            (column + dx, row + dy)
            for dx in range(-reach, reach + 1)
            for dy in range(-reach, reach + 1)
        ):
            if self._is_free(cell):
                yield cell

    def _cells_near(self, wall: Wall) -> Iterator[Cell]:
        (low_x, low_y), radius = self._map.low, self._radius
        left, right = sorted((wall.x1 - low_x, wall.x2 - low_x))
        bottom, top = sorted((wall.y1 - low_y, wall.y2 - low_y))
        for column in range(int((left - radius) // _CELL_M), int((right + radius) // _CELL_M) + 1):
            for row in range(int((bottom - radius) // _CELL_M), int((top + radius) // _CELL_M) + 1):
                if wall.distance(*self._centre((column, row))) < radius:
                    yield column, row


@lru_cache(maxsize=16)
def planner(area: Map, radius: float) -> Planner:
    """The planner for a map and a radius (m); its grid is made once."""
    return Planner(area, radius)
