"""Occupancy grids: a floor that is known from a picture, cell by cell.

Distances come from distance fields, made once per map by scipy: looking one up costs microseconds,
however ragged the walls are, while the walls of a real map, taken as lines, would be thousands. All
of this module is numpy; it is imported only where a map has a picture.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from woosh_robot_agent.simulator.world.collision import Hull
from woosh_robot_agent.simulator.world.geometry import Point, Pose

#: What cells hold, as in nav_msgs/OccupancyGrid; between the two: more or less free.
UNKNOWN, FREE, OCCUPIED = -1, 0, 100

Floats: TypeAlias = npt.NDArray[np.float64]

_FAR_CELLS = 1e6
#: How far past the border of a cell a ray goes on, in cells: rounding must not keep it there.
_PAST = 1e-6


class Grid:
    """The cells of a map.

    The laser sees occupied cells only; a robot drives by itself only where no cell is occupied or
    unknown.

    Attributes:
        cells: int8, in rows from the smallest y to the greatest, each from the smallest x on;
            0 to 99 is free, 100 occupied, -1 unknown.
        resolution: The side of a cell in m.
        low: The corner of the first cell, and so of the grid, in m in the map's frame.
        high: The opposite corner.
    """

    def __init__(self, cells: npt.NDArray[np.int8], resolution: float, low: Point) -> None:
        self.cells = cells
        self.resolution = resolution
        rows, columns = cells.shape
        self.low = low
        self.high: Point = (low[0] + columns * resolution, low[1] + rows * resolution)

    def known(self, x: float, y: float) -> bool:
        """Whether (x, y) lies in a cell that is not unknown."""
        column, row = (math.floor(value) for value in self._in_cells(x, y))
        rows, columns = self.cells.shape
        inside = 0 <= row < rows and 0 <= column < columns
        return inside and int(self.cells[row, column]) != UNKNOWN

    def clearance(self, x: float, y: float) -> float:
        """How far the nearest occupied cell is from (x, y), in m, exact to within a cell."""
        if not self._any_occupied:
            return math.inf
        return float(self._looked_up(self._to_occupied, np.array([[x, y]]))[0])

    def room(self, points: Floats) -> Floats:
        """How far the nearest cell that is not free is from each point, in m.

        Args:
            points: Rows of x and y in m, inside of the grid.
        """
        return self._looked_up(self._to_not_free, points)

    def line_room(self, start: Point, end: Point) -> float:
        """The least `room` on the straight line from `start` to `end`."""
        count = 2 + int(2.0 * math.dist(start, end) / self.resolution)
        return float(self.room(np.linspace(start, end, count)).min())

    def cramped(
        self, first: Point, step: float, columns: int, rows: int, radius: float
    ) -> Iterator[bytes]:
        """Where on a lattice there is less than `radius` (m) of `room`.

        Args:
            first: The lattice's first place, in m.
            step: From one place to the next, in m.
            columns: How many places it has in x.
            rows: How many in y.
            radius: m.

        Yields:
            Each row, with a byte for each place: 1 or 0.
        """
        x = first[0] + step * np.arange(columns)
        for row in range(rows):
            points = np.stack((x, np.full(columns, first[1] + step * row)), axis=1)
            yield (self.room(points) < radius).tobytes()

    def roomiest(self) -> Point:
        """The middle of the free cell with the most room around it."""
        row, column = np.unravel_index(self._to_not_free.argmax(), self.cells.shape)
        return (
            self.low[0] + (float(column) + 0.5) * self.resolution,
            self.low[1] + (float(row) + 0.5) * self.resolution,
        )

    def gap(self, hull: Hull, pose: Pose) -> float:
        """How far in m the outline at `pose` is from touching an occupied cell: see `collision`.

        Cells are squares, taken a little larger where they meet a corner of the outline.
        """
        middle = self._in_cells(pose.x, pose.y)
        reach = hull.radius / self.resolution + 1.0
        (left, bottom), (right, top) = (
            [max(0, math.floor(value + side * reach)) for value in middle] for side in (-1.0, 1.0)
        )
        rows, columns = np.nonzero(self.cells[bottom : top + 1, left : right + 1] == OCCUPIED)
        if not rows.size:
            return math.inf
        x = (columns + (left + 0.5)) * self.resolution + (self.low[0] - pose.x)
        y = (rows + (bottom + 0.5)) * self.resolution + (self.low[1] - pose.y)
        sides = np.array(hull.sides)
        cos, sin = math.cos(pose.theta), math.sin(pose.theta)
        # The outline's sides in the directions of the map.
        nx = sides[:, 0] * cos - sides[:, 1] * sin
        ny = sides[:, 0] * sin + sides[:, 1] * cos
        reach_of_cell = 0.5 * self.resolution * (abs(nx) + abs(ny))
        gaps = np.outer(x, nx) + np.outer(y, ny) - (sides[:, 2] + reach_of_cell)
        return float(gaps.max(axis=1).min())

    def cast(
        self, origin: Point, first: float, increment: float, count: int, furthest: float
    ) -> list[float]:
        """How far rays go before they enter an occupied cell.

        Args:
            origin: Where they start, in m.
            first: The direction of the first one in the map's frame, in rad.
            increment: From one to the next, in rad.
            count: How many they are.
            furthest: m after which a ray is given up.

        Returns:
            m, infinite where nothing was met.
        """
        angles = first + increment * np.arange(count)
        ranges = np.full(count, math.inf)
        x, y = self._in_cells(*origin)
        dx, dy = (np.where(abs(d) < 1e-12, 1e-12, d) for d in (np.cos(angles), np.sin(angles)))
        rows, columns = self.cells.shape
        # From where a ray enters the grid to where it leaves it or is given up.
        x_ends = np.sort((np.array([[0.0], [columns]]) - x) / dx, axis=0)
        y_ends = np.sort((np.array([[0.0], [rows]]) - y) / dy, axis=0)
        gone = np.maximum(np.maximum(x_ends[0], y_ends[0]) + _PAST, 0.0)
        limit = np.minimum(np.minimum(x_ends[1], y_ends[1]) - _PAST, furthest / self.resolution)
        rays = np.flatnonzero(gone < limit)
        dx, dy, gone, limit = dx[rays], dy[rays], gone[rays], limit[rays]
        while rays.size:
            here_x, here_y = x + gone * dx, y + gone * dy
            column, row = here_x.astype(np.intp), here_y.astype(np.intp)
            free = self._to_occupied[row, column]
            hit = free == 0.0
            ranges[rays[hit]] = gone[hit] * self.resolution
            # As far as surely nothing is, at least to the next cell.
            to_next = np.minimum(
                (column + (dx > 0.0) - here_x) / dx, (row + (dy > 0.0) - here_y) / dy
            )
            gone = gone + np.maximum(free - math.sqrt(2.0), to_next + _PAST)
            going = ~hit & (gone < limit)
            rays, dx, dy = rays[going], dx[going], dy[going]
            gone, limit = gone[going], limit[going]
        found: list[float] = ranges.tolist()
        return found

    @cached_property
    def _any_occupied(self) -> bool:
        return bool((self.cells == OCCUPIED).any())

    @cached_property
    def _to_occupied(self) -> npt.NDArray[np.float32]:
        """From the middle of each cell to that of the nearest occupied one, in cells."""
        if not self._any_occupied:
            return np.full(self.cells.shape, _FAR_CELLS, np.float32)
        return _distances(self.cells != OCCUPIED)

    @cached_property
    def _to_not_free(self) -> npt.NDArray[np.float32]:
        """From the middle of each cell to that of the nearest that is not free, in cells."""
        free = (self.cells != OCCUPIED) & (self.cells != UNKNOWN)
        # What lies beyond the grid is unknown.
        return _distances(np.pad(free, 1))[1:-1, 1:-1]

    def _in_cells(self, x: float, y: float) -> Point:
        return (x - self.low[0]) / self.resolution, (y - self.low[1]) / self.resolution

    def _looked_up(self, field: npt.NDArray[np.float32], points: Floats) -> Floats:
        places = (points - self.low) / self.resolution - 0.5
        found = ndimage.map_coordinates(
            field, places[:, ::-1].T, output=np.float64, order=1, mode="nearest"
        )
        # From the middle of the nearest cell to its border.
        return np.maximum(0.0, (found - 0.5) * self.resolution)


def _distances(free: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
    distances: npt.NDArray[np.float64] = ndimage.distance_transform_edt(free)
    return distances.astype(np.float32)
