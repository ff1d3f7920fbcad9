"""The raster of a map's cells, and their values."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from woosh_robot_agent.simulator.world.geometry import Point

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
"""Values of cells, as in nav_msgs/OccupancyGrid. Values between FREE and OCCUPIED count as free."""


Cells: TypeAlias = npt.NDArray[np.int8]


class Raster(NamedTuple):
    """The cells of a map.

    Attributes:
        cells: Values as in `world.cells`, in rows by increasing y, each by increasing x.
        resolution: Side of a cell, in metres.
        low: Corner of the raster with the smallest x and y, in metres in the map's frame.
    """

    cells: Cells
    resolution: float
    low: Point
