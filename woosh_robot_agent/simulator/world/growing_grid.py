"""Makes occupancy grids from the scans of a laser; the grids grow with the scans.

Each cell has a number, its evidence: a scan with rays through the cell lowers it, a scan with an
echo in the cell raises it. The pose of each scan is known: no scan matching is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from woosh_robot_agent.simulator.world.geometry import Point, Pose

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
"""Values of cells, as in nav_msgs/OccupancyGrid. Values between FREE and OCCUPIED count as free."""

Cells: TypeAlias = npt.NDArray[np.int8]


class Raster(NamedTuple):
    """The cells of a map.

    Attributes:
        cells: UNKNOWN or FREE to OCCUPIED, in rows by increasing y, each by increasing x.
        resolution: side of a cell, in metres.
        low: corner of the raster with the smallest x and y, in metres in the map's frame.
    """

    cells: Cells
    resolution: float
    low: Point


RESOLUTION = 0.05
"""Side of a cell of a new map, in metres."""

_ECHO, _MAX_EVIDENCE, _MIN_EVIDENCE = 2, 20, -10
"""Evidence of a scan with echoes in a cell, and limits of the sum. Rays through a cell are -1.

Because of the limits, a few scans can change a cell, however often it was seen before.
"""

_INTO_WALL = 0.0125
"""Distance in metres by which an echo is moved further along its ray.

It exceeds the noise of the laser, so that all echoes of a wall are in the same cell.
"""

_MARGIN = 64
"""Number of cells by which the grid grows beyond what is needed, so that it grows seldom."""

_EDGE = 10
"""Width of the border of unknown cells around the known cells in the raster, in cells."""

_MAX_CELLS = 4096 * 4096
"""Maximum number of cells, as for a map that is read from a picture."""

Indices: TypeAlias = npt.NDArray[np.intp]


class GrowingGrid:
    """An occupancy grid that grows with the scans of a laser.

    Args:
        base: map to continue, None for a new map.

    Attributes:
        resolution: side of a cell, in metres.
        full: True if a scan or floor was left out because the grid would have become too large.
    """

    def __init__(self, base: Raster | None = None) -> None:
        self.full = False
        if base is None:
            self.resolution = RESOLUTION
            # Walls are often at multiples of the resolution. This puts them in the middle of cells.
            self._anchor = (-0.5 * RESOLUTION, -0.5 * RESOLUTION)
            """Corner from which columns and rows are counted, in metres in the map's frame."""
            self._evidence: Cells = np.zeros((1, 1), np.int8)
            """For each cell: positive if it is occupied, negative if free, 0 if unknown."""
        else:
            self.resolution = base.resolution
            self._anchor = base.low
            self._evidence = np.full(base.cells.shape, _MIN_EVIDENCE, np.int8)
            self._evidence[base.cells == OCCUPIED] = _MAX_EVIDENCE
            self._evidence[base.cells == UNKNOWN] = 0
        self._left = self._bottom = 0
        """Column and row of the first cell of `_evidence`, counted from the anchor."""

    def add_scan(
        self, laser: Pose, first: float, increment: float, ranges: Sequence[float]
    ) -> None:
        """Add a scan. Rays without an echo are ignored.

        Args:
            laser: pose of the laser in the map's frame.
            first: angle of the first ray from straight ahead, in radians.
            increment: angle between two rays, in radians.
            ranges: lengths of the rays in metres, infinite for a ray without an echo.
        """
        lengths = np.array(ranges)
        echoes = np.isfinite(lengths)
        # A ray without an echo ends at the laser, so that it covers nothing.
        lengths = np.where(echoes, lengths + _INTO_WALL, 0.0)
        angles = laser.theta + first + increment * np.arange(lengths.size)
        columns, rows = self._indices(
            laser.x + lengths * np.cos(angles), laser.y + lengths * np.sin(angles)
        )
        column, row = self._indices(np.array([laser.x]), np.array([laser.y]))
        self._add_evidence(
            np.append(columns, column), np.append(rows, row), columns[echoes], rows[echoes]
        )

    def add_floor(self, corners: Sequence[Point]) -> None:
        """Add free floor inside a polygon, e.g. the outline of the robot.

        Args:
            corners: corners of the polygon in the map's frame, in metres.
        """
        x, y = np.array(corners).T
        columns, rows = self._indices(x, y)
        none = columns[:0]
        self._add_evidence(columns, rows, echo_columns=none, echo_rows=none)

    def raster(self) -> Raster:
        """Return the current map: its known cells with an edge of unknown cells around them."""
        evidence = self._evidence
        rows, columns = (np.flatnonzero((evidence != 0).any(axis=axis)) for axis in (1, 0))
        if not rows.size:
            rows = columns = np.zeros(1, np.intp)
        inner = evidence[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        cells = np.full(inner.shape, UNKNOWN, np.int8)
        cells[inner > 0] = OCCUPIED
        cells[inner < 0] = FREE
        low = (
            self._anchor[0] + (self._left + int(columns[0]) - _EDGE) * self.resolution,
            self._anchor[1] + (self._bottom + int(rows[0]) - _EDGE) * self.resolution,
        )
        return Raster(np.pad(cells, _EDGE, constant_values=UNKNOWN), self.resolution, low)

    def _indices(
        self, x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]
    ) -> tuple[Indices, Indices]:
        """Return columns and rows of positions in metres, counted from the anchor."""
        columns = np.floor((x - self._anchor[0]) / self.resolution).astype(np.intp)
        rows = np.floor((y - self._anchor[1]) / self.resolution).astype(np.intp)
        return columns, rows

    def _add_evidence(
        self, columns: Indices, rows: Indices, echo_columns: Indices, echo_rows: Indices
    ) -> None:
        """Add free cells inside the polygon with corners in `columns` and `rows`, and echoes.

        If they would make the grid too large, set `full` instead.
        """
        left, right = int(columns.min()), int(columns.max())
        bottom, top = int(rows.min()), int(rows.max())
        if not self._reserve(left, bottom, right, top):
            self.full = True
            return
        image = Image.new("L", (right - left + 1, top - bottom + 1))
        corners = np.stack((columns - left, rows - bottom), axis=1).ravel().tolist()
        # Between two distant echoes, a side of the polygon runs through cells of a wall, and a
        # corner may be an echo. So sides and corners do not count as free.
        ImageDraw.Draw(image).polygon(corners, fill=1, outline=0)
        passed = np.array(image).view(np.int8)
        passed[rows - bottom, columns - left] = 0
        part = self._evidence[
            bottom - self._bottom : top - self._bottom + 1,
            left - self._left : right - self._left + 1,
        ]
        np.subtract(part, passed, out=part)
        np.maximum(part, _MIN_EVIDENCE, out=part)
        echoes = echo_rows - bottom, echo_columns - left
        part[echoes] = np.minimum(part[echoes] + _ECHO, _MAX_EVIDENCE)

    def _reserve(self, left: int, bottom: int, right: int, top: int) -> bool:
        """Grow to include these columns and rows; return False if the grid would be too large."""
        height, width = self._evidence.shape
        # Rows below and above, columns before and after.
        growth = [
            missing + _MARGIN if missing > 0 else 0
            for missing in (
                self._bottom - bottom,
                top - (self._bottom + height - 1),
                self._left - left,
                right - (self._left + width - 1),
            )
        ]
        if not any(growth):
            return True
        below, above, before, after = growth
        if (height + below + above) * (width + before + after) > _MAX_CELLS:
            return False
        self._evidence = np.pad(self._evidence, ((below, above), (before, after)))
        self._bottom -= below
        self._left -= before
        return True
