"""Rasters: the cells of a map without anything that is computed from them."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from woosh_robot_agent.simulator.world.geometry import Point

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
