"""Occupancy grids: the cells of maps that are given as pictures or made by the robot.

Distances are looked up in distance fields, which scipy computes once per map. A look-up takes
microseconds, whereas a real map would need thousands of walls. This module needs numpy and scipy,
which load slowly: it is only imported when a map has cells.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from woosh_robot_agent.simulator.world.geometry import Hull, Point, Pose
from woosh_robot_agent.simulator.world.growing_grid import OCCUPIED, UNKNOWN, Raster

Floats: TypeAlias = npt.NDArray[np.float64]
KeepOut: TypeAlias = npt.NDArray[np.bool_]

_FAR = 1e6
"""Distance to the nearest occupied cell in a grid without occupied cells, in cells."""

_OVERSHOOT = 1e-6
"""Distance by which a ray goes past a border, so that it is in the next cell for sure, in cells."""


class Grid:
    """The cells of a map.

    The laser sees only occupied cells. Planned paths avoid occupied, unknown and keep-out cells.

    Attributes:
        cells: values of type int8, in rows by increasing y, each by increasing x: 0 to 99 is free,
            100 occupied, -1 unknown.
        resolution: side of a cell, in metres.
        low: corner of the grid with the smallest x and y, in metres in the map's frame.
        high: opposite corner, in metres.
        keep_out: True for each keep-out cell, in the order of `cells`; None without such cells.
    """

    def __init__(
        self,
        cells: npt.NDArray[np.int8],
        resolution: float,
        low: Point,
        keep_out: KeepOut | None = None,
    ) -> None:
        self.cells = cells
        self.keep_out = keep_out
        self.resolution = resolution
        rows, columns = cells.shape
        self.low = low
        self.high: Point = (low[0] + columns * resolution, low[1] + rows * resolution)

    def kept_out(self, x: float, y: float) -> bool:
        """Return True if (x, y) is in a keep-out cell."""
        cell = self._cell(x, y)
        return bool(cell and self.keep_out is not None and self.keep_out[cell])

    def keep_out_on(self, raster: Raster) -> KeepOut | None:
        """Return the keep-out cells on another raster of the same map and resolution."""
        if self.keep_out is None:
            return None
        keep_out: KeepOut = np.zeros(raster.cells.shape, np.bool_)
        rows, columns = np.nonzero(self.keep_out)
        columns = columns + round((self.low[0] - raster.low[0]) / self.resolution)
        rows = rows + round((self.low[1] - raster.low[1]) / self.resolution)
        height, width = keep_out.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        keep_out[rows[inside], columns[inside]] = True
        return keep_out

    def known(self, x: float, y: float) -> bool:
        """Return True if (x, y) is in a cell that is not unknown."""
        cell = self._cell(x, y)
        return bool(cell and self.cells[cell] != UNKNOWN)

    def clearance(self, x: float, y: float) -> float:
        """Return the distance from (x, y) to the nearest occupied cell, in metres.

        It is exact to within a cell, and infinite if no cell is occupied.
        """
        if not self._any_occupied:
            return math.inf
        return float(self._interpolated(self._to_occupied, np.array([[x, y]]))[0])

    def room(self, points: Floats) -> Floats:
        """Return the distance from each point to the nearest cell that is not free, in metres.

        Args:
            points: rows of x and y in metres, inside the grid.
        """
        return self._interpolated(self._to_not_free, points)

    def line_room(self, start: Point, end: Point) -> float:
        """Return the minimum of `room` on the straight line from `start` to `end`, in metres."""
        count = 2 + int(2.0 * math.dist(start, end) / self.resolution)
        return float(self.room(np.linspace(start, end, count)).min())

    def blocked_rows(
        self, first: Point, step: float, columns: int, rows: int, radius: float
    ) -> Iterator[bytes]:
        """Find the places of a lattice with less `room` than `radius`, row by row.

        Args:
            first: position of the place with the smallest x and y, in metres.
            step: distance between neighbouring places, in metres.
            columns: number of places in x direction.
            rows: number of places in y direction.
            radius: room that a place needs, in metres.

        Yields:
            Each row of the lattice, with a byte for each place: 1 if it lacks room, else 0.
        """
        x = first[0] + step * np.arange(columns)
        for row in range(rows):
            points = np.stack((x, np.full(columns, first[1] + step * row)), axis=1)
            yield (self.room(points) < radius).tobytes()

    def roomiest(self) -> Point:
        """Return the centre of the free cell with the most room around it."""
        row, column = np.unravel_index(self._to_not_free.argmax(), self.cells.shape)
        return (
            self.low[0] + (float(column) + 0.5) * self.resolution,
            self.low[1] + (float(row) + 0.5) * self.resolution,
        )

    def gap(self, hull: Hull, pose: Pose) -> float:
        """Return the gap in metres between the outline at `pose` and the nearest occupied cell.

        It is negative if they overlap, and infinite if no occupied cell is near. Near a corner of
        the outline, it is slightly underestimated.
        """
        # Only cells in a square around the robot can be near.
        column, row = self._in_cells(pose.x, pose.y)
        reach = hull.radius / self.resolution + 1.0
        # At least 0, because a negative index would count from the other end.
        left, right = (max(0, math.floor(column + offset)) for offset in (-reach, reach))
        bottom, top = (max(0, math.floor(row + offset)) for offset in (-reach, reach))
        rows, columns = np.nonzero(self.cells[bottom : top + 1, left : right + 1] == OCCUPIED)
        if not rows.size:
            return math.inf
        # Centres of the occupied cells from the centre of the robot, in metres.
        x = (columns + (left + 0.5)) * self.resolution + (self.low[0] - pose.x)
        y = (rows + (bottom + 0.5)) * self.resolution + (self.low[1] - pose.y)
        sides = np.array(hull.sides)  # for each: its unit normal (x, y), and its distance
        cos, sin = math.cos(pose.theta), math.sin(pose.theta)
        # Normals of the outline's sides in the map's frame.
        nx = sides[:, 0] * cos - sides[:, 1] * sin
        ny = sides[:, 0] * sin + sides[:, 1] * cos
        reach_of_cell = 0.5 * self.resolution * (abs(nx) + abs(ny))
        gaps = np.outer(x, nx) + np.outer(y, ny) - (sides[:, 2] + reach_of_cell)
        # The gap to a cell is its greatest distance from a side; the nearest cell counts.
        return float(gaps.max(axis=1).min())

    def cast(
        self, origin: Point, first: float, increment: float, count: int, max_range: float
    ) -> list[float]:
        """Cast rays until they enter an occupied cell.

        Args:
            origin: start of the rays, in metres.
            first: direction of the first ray in the map's frame, in radians.
            increment: angle between two rays, in radians.
            count: number of rays.
            max_range: length at which a ray ends, in metres.

        Returns:
            The lengths of the rays in metres, infinite for a ray that hits nothing.
        """
        angles = first + increment * np.arange(count)
        ranges = np.full(count, math.inf)
        x, y = self._in_cells(*origin)
        # Without zeros, by which the lengths below would be divided.
        dx, dy = (np.where(abs(d) < 1e-12, 1e-12, d) for d in (np.cos(angles), np.sin(angles)))
        rows, columns = self.cells.shape
        # Lengths in cells at which each ray enters the grid, and at which it leaves it or ends.
        x_ends = np.sort((np.array([[0.0], [columns]]) - x) / dx, axis=0)
        y_ends = np.sort((np.array([[0.0], [rows]]) - y) / dy, axis=0)
        travelled = np.maximum(np.maximum(x_ends[0], y_ends[0]) + _OVERSHOOT, 0.0)
        limit = np.minimum(
            np.minimum(x_ends[1], y_ends[1]) - _OVERSHOOT, max_range / self.resolution
        )
        rays = np.flatnonzero(travelled < limit)
        dx, dy, travelled, limit = dx[rays], dy[rays], travelled[rays], limit[rays]
        while rays.size:
            here_x, here_y = x + travelled * dx, y + travelled * dy
            column, row = here_x.astype(np.intp), here_y.astype(np.intp)
            to_occupied = self._to_occupied[row, column]
            hit = to_occupied == 0.0
            ranges[rays[hit]] = travelled[hit] * self.resolution
            # Advance through space that is certainly free, and at least to the next cell.
            to_next = np.minimum(
                (column + (dx > 0.0) - here_x) / dx, (row + (dy > 0.0) - here_y) / dy
            )
            travelled = travelled + np.maximum(to_occupied - math.sqrt(2.0), to_next + _OVERSHOOT)
            going = ~hit & (travelled < limit)
            rays, dx, dy = rays[going], dx[going], dy[going]
            travelled, limit = travelled[going], limit[going]
        lengths: list[float] = ranges.tolist()
        return lengths

    @cached_property
    def _any_occupied(self) -> bool:
        return bool((self.cells == OCCUPIED).any())

    @cached_property
    def _to_occupied(self) -> npt.NDArray[np.float32]:
        """Distance from each cell to the nearest occupied cell, centre to centre, in cells."""
        if not self._any_occupied:
            return np.full(self.cells.shape, _FAR, np.float32)
        return _distances(self.cells != OCCUPIED)

    @cached_property
    def _to_not_free(self) -> npt.NDArray[np.float32]:
        """Distance from each cell to the nearest one that is not free, centre to centre, in cells.

        Keep-out cells and everything outside the grid are not free.
        """
        free = (self.cells != OCCUPIED) & (self.cells != UNKNOWN)
        if self.keep_out is not None:
            free &= ~self.keep_out
        return _distances(np.pad(free, 1))[1:-1, 1:-1]

    def _cell(self, x: float, y: float) -> tuple[int, int] | None:
        """Return row and column of the cell at (x, y), None outside the grid."""
        column, row = (math.floor(value) for value in self._in_cells(x, y))
        rows, columns = self.cells.shape
        return (row, column) if 0 <= row < rows and 0 <= column < columns else None

    def _in_cells(self, x: float, y: float) -> Point:
        """Return (x, y) relative to the corner `low`, in cells."""
        return (x - self.low[0]) / self.resolution, (y - self.low[1]) / self.resolution

    def _interpolated(self, field: npt.NDArray[np.float32], points: Floats) -> Floats:
        """Return the distance at each point, in metres, interpolated between the nearest cells.

        Args:
            field: `_to_occupied` or `_to_not_free`.
            points: rows of x and y, in metres.
        """
        # Cell 0 has its centre half a cell from the corner `low`.
        columns, rows = ((points - self.low) / self.resolution - 0.5).T
        distances = ndimage.map_coordinates(
            field, np.stack((rows, columns)), output=np.float64, order=1, mode="nearest"
        )
        # The field gives distances to the centres of cells; subtract the half cell to the border.
        return np.maximum(0.0, (distances - 0.5) * self.resolution)


def _distances(free: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
    """Return the distance from each cell to the nearest False one, centre to centre, in cells."""
    distances: npt.NDArray[np.float64] = ndimage.distance_transform_edt(free)
    return distances.astype(np.float32)
