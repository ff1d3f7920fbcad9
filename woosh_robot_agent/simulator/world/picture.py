"""Draws maps as pictures with the grey values of nav2's map_saver."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from woosh_robot_agent.simulator.world.geometry import Point
from woosh_robot_agent.simulator.world.growing_grid import FREE, OCCUPIED, UNKNOWN, Cells, Raster
from woosh_robot_agent.simulator.world.maps import Map

_RESOLUTION = 0.05
"""Side of a pixel in the picture of a map without a grid, in metres."""

_MAX_DRAWN_PIXELS = 2048 * 2048
"""Maximum number of pixels of a map without a grid. Larger maps have larger pixels."""

_EDGE = 0.5
"""Width of the unknown border around a map without a grid, in metres."""

_GREY_OCCUPIED, _GREY_UNKNOWN, _GREY_FREE = 0, 205, 254
"""Grey values of map_saver. A `free_thresh` of 0.196 distinguishes unknown from free."""

_GREY_ALLOWED = 216
"""Grey value of allowed floor in the picture of keep-out areas, as in a robot's pictures."""


@dataclass(frozen=True, eq=False)
class Picture:
    """The picture of a map: 0 is occupied, 254 free and 205 unknown.

    Attributes:
        png: the picture as PNG. Its last row has the smallest y.
        resolution: side of a pixel, in metres.
        low: lower left corner of the picture, in metres in the map's frame.
        keepout: picture of the same size as PNG, in which keep-out areas are black; empty without
            such areas.
    """

    png: bytes
    resolution: float
    low: Point
    keepout: bytes


@lru_cache(maxsize=32)
def draw(area: Map) -> Picture:
    """Return the picture of a map with its walls, from a cache."""
    raster = rasterised(area)
    keep_out = area.grid.keep_out if area.grid else None
    keepout = b"" if keep_out is None else _png(np.where(keep_out, 0, _GREY_ALLOWED))
    return Picture(png(raster.cells), raster.resolution, raster.low, keepout)


def rasterised(area: Map) -> Raster:
    """Return the cells of a map as a copy, with its walls drawn into them."""
    if area.grid:
        cells, resolution, low = area.grid.cells.copy(), area.grid.resolution, area.grid.low
    else:
        cells, resolution, low = _free_area(area)
    _draw_walls(cells, area, resolution, low)
    return Raster(cells, resolution, low)


def png(cells: Cells) -> bytes:
    """Return the picture of `Raster.cells` as PNG."""
    greys = np.full(cells.shape, _GREY_FREE, np.uint8)
    greys[cells == OCCUPIED] = _GREY_OCCUPIED
    greys[cells == UNKNOWN] = _GREY_UNKNOWN
    return _png(greys)


def _png(greys: npt.NDArray[np.integer[Any]]) -> bytes:
    """Return grey values, in rows by increasing y, as PNG. Its first row has the largest y."""
    buffer = io.BytesIO()
    Image.fromarray(greys[::-1].astype(np.uint8)).save(buffer, "PNG")
    return buffer.getvalue()


def _free_area(area: Map) -> tuple[Cells, float, Point]:
    """Return cells that are free inside the mapped area and unknown around it.

    Returns:
        The cells, their resolution in metres, and the position of their lower left corner.
    """
    sides = [high - low for low, high in zip(area.low, area.high, strict=True)]
    resolution = _RESOLUTION
    while (sides[0] / resolution) * (sides[1] / resolution) > _MAX_DRAWN_PIXELS:
        resolution *= 2.0
    edge = round(_EDGE / resolution)
    columns, rows = (round(side / resolution) + 1 for side in sides)
    cells: Cells = np.full((rows + 2 * edge, columns + 2 * edge), UNKNOWN, np.int8)
    cells[edge : edge + rows, edge : edge + columns] = FREE
    # Align walls on the border of the area with the centres of pixels.
    around = (edge + 0.5) * resolution
    return cells, resolution, (area.low[0] - around, area.low[1] - around)


def _draw_walls(cells: Cells, area: Map, resolution: float, low: Point) -> None:
    """Make the cells along the walls of a map occupied."""
    for wall in area.walls:
        length = math.dist((wall.x1, wall.y1), (wall.x2, wall.y2))
        count = 2 + int(4.0 * length / resolution)  # about four points per cell: no gaps
        points = np.linspace((wall.x1, wall.y1), (wall.x2, wall.y2), count)
        columns, rows = np.floor((points - low) / resolution).astype(np.intp).T
        height, width = cells.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        cells[rows[inside], columns[inside]] = OCCUPIED
