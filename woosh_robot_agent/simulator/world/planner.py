"""Path planner: A* on a lattice of places on free floor; then the path is straightened."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache, partial

from woosh_robot_agent.simulator.world.geometry import Point, Wall
from woosh_robot_agent.simulator.world.maps import Map

PATH_MARGIN = 0.05
"""Clearance of planned paths in addition to the radius of the robot, in metres."""

_SPACING = 0.2
"""Distance between neighbouring places of the lattice, in metres."""

_REACH = 0.6
"""Maximum distance at which the ends of a path are connected to the lattice, in metres."""

_MIN_CLEARANCE = 1e-3
"""Clearance that even a start close to a wall needs, in metres."""

_MAX_PLACES = 300_000
"""Maximum number of places that the search of a path visits. It takes about a second, and is enough
for 100 x 100 m."""

_DIAGONAL_EXTRA = math.sqrt(2.0) - 1.0
"""Extra length of a diagonal step, as a fraction of a straight step."""


class SearchBudgetError(Exception):
    """The search of a path has visited too many places."""


class SearchBudget:
    """Limit of the search of one path, all its legs together. A search blocks the simulator.

    Attributes:
        left: number of places that may still be visited.
    """

    def __init__(self, left: int = _MAX_PLACES) -> None:
        self.left = left

    def visit(self) -> None:
        """Count a visit of a place; raise SearchBudgetError if the budget is used up."""
        self.left -= 1
        if self.left < 0:
            raise SearchBudgetError


class Lattice:
    """The regular places on a map that a search visits.

    The places are numbered row by row, from the corner with the smallest x and y. A border of
    blocked places around them keeps the search inside.
    """

    def __init__(self, area: Map) -> None:
        (left, bottom), (right, top) = area.low, area.high
        self._low = area.low
        self._columns = math.floor((right - left) / _SPACING + 1e-6)
        self._rows = math.floor((top - bottom) / _SPACING + 1e-6)
        self._width = self._columns + 2  # with the border
        # For each neighbour: the difference of the place numbers, and the distance in metres.
        self._steps = tuple(
            (dx + dy * self._width, _SPACING * math.hypot(dx, dy))
            for dx in (-1, 0, 1)
            for dy in (-1, 0, 1)
            if (dx, dy) != (0, 0)
        )

    def blocked_places(self, area: Map, radius: float) -> bytearray:
        """Return a byte for each place: 1 if a wall or cell of the map is within `radius` (m)."""
        rows: Iterable[bytes] = [bytes(self._columns)] * self._rows
        if area.grid:
            first = self._low[0] + 0.5 * _SPACING, self._low[1] + 0.5 * _SPACING
            rows = area.grid.blocked_rows(first, _SPACING, self._columns, self._rows, radius)
        border = b"\1" * self._width
        places = bytearray(b"".join((border, *(b"\1" + row + b"\1" for row in rows), border)))
        self.block(places, area.walls, radius)
        return places

    def block(self, places: bytearray, walls: Iterable[Wall], radius: float) -> None:
        """Block the places that have one of `walls` within `radius` (m)."""
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
        """Yield the places within reach of a point, with their positions in metres."""
        x, y = point
        for place in self._within(x - _REACH, y - _REACH, x + _REACH, y + _REACH):
            centre = self.centre(place)
            if math.dist(centre, point) <= _REACH:
                yield place, centre

    def search(
        self,
        first: dict[int, float],
        last: set[int],
        goal: Point,
        blocked: bytearray,
        budget: SearchBudget,
    ) -> list[int] | None:
        """Return the shortest path as the numbers of its places, or None if there is none (A*).

        Args:
            first: places where the path can start, with their distances from the start in metres.
            last: places where the path can end, all near the goal.
            goal: position of the goal, in metres.
            blocked: bytes for all places, as from `blocked_places`: the path avoids those with 1.

        Raises:
            SearchBudgetError: the budget was used up before the search ended.
        """
        width, steps = self._width, self._steps
        goal_column = (goal[0] - self._low[0]) / _SPACING + 0.5
        goal_row = (goal[1] - self._low[1]) / _SPACING + 0.5

        def heuristic(place: int) -> float:
            """Return the length of the shortest path of straight and diagonal steps to the goal."""
            row, column = divmod(place, width)
            along, across = abs(goal_column - column), abs(goal_row - row)
            if along < across:
                along, across = across, along
            return _SPACING * (along + _DIAGONAL_EXTRA * across)

        costs = dict(first)
        frontier = [(cost + heuristic(place), cost, place) for place, cost in first.items()]
        heapq.heapify(frontier)
        came_from: dict[int, int] = {}
        while frontier:
            _, cost, place = heapq.heappop(frontier)
            if cost > costs[place]:
                continue
            budget.visit()
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
                    heapq.heappush(frontier, (new_cost + heuristic(other), new_cost, other))
        return None

    def centre(self, place: int) -> Point:
        """Return the position of a place, in metres."""
        row, column = divmod(place, self._width)
        return self._low[0] + (column - 0.5) * _SPACING, self._low[1] + (row - 0.5) * _SPACING

    def _within(self, left: float, bottom: float, right: float, top: float) -> Iterator[int]:
        """Yield the places in a rectangle in the map's frame, in metres."""
        columns = self._span(left - self._low[0], right - self._low[0], self._columns)
        for row in self._span(bottom - self._low[1], top - self._low[1], self._rows):
            for column in columns:
                yield (row + 1) * self._width + column + 1

    @staticmethod
    def _span(low: float, high: float, count: int) -> range:
        """Return which of `count` columns or rows are between two distances from `_low` (m)."""
        return range(
            max(0, math.floor(low / _SPACING)), min(count, math.floor(high / _SPACING) + 1)
        )


class Planner:
    """Plans paths on one map that keep `radius` metres away from walls."""

    def __init__(self, area: Map, radius: float) -> None:
        self._map = area
        self._radius = radius
        self._lattice = Lattice(area)
        self._blocked = self._lattice.blocked_places(area, radius)
        """For each place of the lattice: 1 if a wall or cell of the map is too close, else 0."""

    def plan(
        self,
        start: Point,
        goal: Point,
        obstacles: Sequence[Wall] = (),
        budget: SearchBudget | None = None,
    ) -> list[Point] | None:
        """Return the corners of a free path, or None if there is no path.

        Args:
            start: start of the path, in metres. It is not among the corners.
            goal: end of the path, in metres. It is the last corner.
            obstacles: walls to avoid in addition to the walls of the map.
            budget: limit of the search, shared by the legs of one path; None for a new one.

        Raises:
            SearchBudgetError: the budget was used up before a path was found.
        """
        budget = budget or SearchBudget()
        walls = (*self._map.walls, *obstacles)

        def free(here: Point, there: Point, radius: float) -> bool:
            return self._free(here, there, radius, walls)

        if not (self._map.contains(*goal) and free(goal, goal, self._radius)):
            return None
        # A robot that is closer to a wall than `radius` may still leave its place.
        start_clearance = self._start_clearance(start, walls)
        if start_clearance < _MIN_CLEARANCE:
            return None
        if free(start, goal, start_clearance):
            return [goal]
        blocked = self._blocked
        if obstacles:
            blocked = blocked.copy()
            self._lattice.block(blocked, obstacles, self._radius)
        first = {
            place: math.dist(start, there)
            for place, there in self._lattice.around(start)
            if not blocked[place] and free(start, there, start_clearance)
        }
        last = {
            place
            for place, there in self._lattice.around(goal)
            if not blocked[place] and free(goal, there, self._radius)
        }
        places = self._lattice.search(first, last, goal, blocked, budget)
        if places is None:
            return None
        corners = [start, *map(self._lattice.centre, places), goal]

        def in_sight(here: int, there: int) -> bool:
            return free(corners[here], corners[there], self._radius if here else start_clearance)

        path: list[Point] = []
        here = 0
        while here < len(corners) - 1:
            here = _furthest(here + 1, len(corners) - 1, partial(in_sight, here))
            path.append(corners[here])
        return path

    def _start_clearance(self, start: Point, walls: Sequence[Wall]) -> float:
        """Return the clearance in metres that a path can keep at its start, at most `_radius`."""
        room = min((wall.distance(*start) for wall in walls), default=self._radius)
        if self._map.grid:
            room = min(room, self._map.grid.line_room(start, start))
        return min(self._radius, room - 1e-6)

    def _free(self, start: Point, end: Point, radius: float, walls: Sequence[Wall]) -> bool:
        """Return True if the line from `start` to `end` has a clearance of `radius` (m)."""
        left, right = min(start[0], end[0]) - radius, max(start[0], end[0]) + radius
        bottom, top = min(start[1], end[1]) - radius, max(start[1], end[1]) + radius
        for wall in walls:
            # This excludes most walls quickly.
            may_be_near = (
                (wall.x1 > left or wall.x2 > left)
                and (wall.x1 < right or wall.x2 < right)
                and (wall.y1 > bottom or wall.y2 > bottom)
                and (wall.y1 < top or wall.y2 < top)
            )
            if may_be_near and wall.line_distance(start, end) < radius:
                return False
        return self._map.grid is None or self._map.grid.line_room(start, end) >= radius


def _furthest(good: int, last: int, fits: Callable[[int], bool]) -> int:
    """Return the largest number from `good` to `last` that fits, if all below it fit too.

    Otherwise return another number that fits. `good` must fit. The search doubles its steps until a
    number does not fit, then bisects.
    """
    step = 1
    bad = last + 1
    while good < last:
        candidate = min(good + step, last)
        if not fits(candidate):
            bad = candidate
            break
        good = candidate
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
    """Return the planner for a map and a clearance of `radius` (m), from a cache."""
    return Planner(area, radius)
