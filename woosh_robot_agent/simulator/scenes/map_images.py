"""Maps as pictures: those of nav2's map_server are read, and any map can be drawn as one.

A picture comes with a YAML file that says what it means, as nav2's map_saver writes both; the same
rules hold as in nav2's map_server. PNG and PGM (plain or raw) are read.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from PIL import Image

from woosh_robot_agent.simulator.scenes.yaml_fields import Node, SceneError
from woosh_robot_agent.simulator.world.geometry import Point
from woosh_robot_agent.simulator.world.grid import FREE, OCCUPIED, UNKNOWN, Grid
from woosh_robot_agent.simulator.world.maps import Map

#: 200 by 200 m in cells of 5 cm; its distance fields take some seconds.
_MOST_PIXELS = 4096 * 4096
_MODES = ("trinary", "scale", "raw")

#: How maps without a picture are drawn: the side of a pixel and the edge around the map, in m.
_DRAWN_RESOLUTION_M = 0.05
_DRAWN_EDGE_M = 0.5

#: Grey values as map_saver writes them. A free_thresh of 0.196 tells unknown from free.
_GREY_OCCUPIED, _GREY_UNKNOWN, _GREY_FREE = 0, 205, 254

Cells: TypeAlias = npt.NDArray[np.int8]
Floats: TypeAlias = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Picture:
    """A map as a picture, in the grey values of map_saver: 0 occupied, 254 free, 205 unknown.

    Attributes:
        png: The picture; its last row has the smallest y.
        resolution: The side of a pixel in m.
        low: The lower left corner of the lower left pixel, in m in the map's frame.
    """

    png: bytes
    resolution: float
    low: Point


def read_grid(description: Node, read: Callable[[str], bytes]) -> Grid:
    """The grid that a YAML file of map_server describes.

    Args:
        description: The file's content. Keys that map_server doesn't know are skipped, as there.
        read: Gives the bytes of a file that is named in it; raises `SceneError` if it cannot.

    Raises:
        SceneError: A file cannot be used.
    """
    name = description.need("image").text()
    mode = description.get("mode")
    resolution = description.need("resolution")
    if not 0.001 <= resolution.number() <= 10.0:
        raise resolution.error("the side of a pixel must be within 0.001 to 10 m")
    origin = description.need("origin")
    x, y, yaw = origin.numbers("x, y, yaw")
    if yaw:
        raise origin.error("the map must not be turned: turn the picture, and make yaw 0")
    negate = description.need("negate")
    if negate.value not in (0, 1):  # and so False or True
        raise negate.error("0 or 1 is needed")
    occupied, free = description.need("occupied_thresh"), description.need("free_thresh")
    if not 0.0 <= free.number() < occupied.number() <= 1.0:
        raise free.error(f"needed are 0 <= free_thresh < occupied_thresh ({occupied.value}) <= 1")
    cells = _cells(
        *_pixels(name, read(name)),
        mode=mode.choice(_MODES) if mode else _MODES[0],
        negate=bool(negate.value),
        occupied=occupied.number(),
        free=free.number(),
    )
    # Pictures begin with their upper row, which has the greatest y.
    return Grid(np.ascontiguousarray(cells[::-1]), resolution.number(), (x, y))


@lru_cache(maxsize=32)
def picture(area: Map) -> Picture:
    """A map as a picture, with its walls in it; it is drawn once."""
    if area.grid:
        cells, resolution, low = area.grid.cells.copy(), area.grid.resolution, area.grid.low
    else:
        cells, resolution, low = _floor(area)
    _draw_walls(cells, area, resolution, low)
    greys = np.full(cells.shape, _GREY_FREE, np.uint8)
    greys[cells == OCCUPIED] = _GREY_OCCUPIED
    greys[cells == UNKNOWN] = _GREY_UNKNOWN
    buffer = io.BytesIO()
    Image.fromarray(greys[::-1]).save(buffer, "PNG")
    return Picture(buffer.getvalue(), resolution, low)


def _pixels(name: str, data: bytes) -> tuple[Floats, Floats | None]:
    """The brightness of each pixel and, where there is transparency, its opacity: both 0 to 1."""
    try:
        image: Image.Image = Image.open(io.BytesIO(data), formats=("PNG", "PPM"))
        width, height = image.size
        if not 0 < width * height <= _MOST_PIXELS:
            raise SceneError(
                f"{name}: {width} x {height} pixels are not within 1 to {_MOST_PIXELS}: cut it "
                "into several maps, or make its pixels larger"
            )
        image.load()
        if "transparency" in image.info or "A" in image.getbands():
            image = image.convert("RGBA")
        elif image.mode == "P":
            image = image.convert("RGB")
        elif image.mode == "1":
            image = image.convert("L")
    except SceneError:
        raise
    except Exception as error:  # Pillow checks as it reads, and raises whatever comes
        raise SceneError(f"{name}: not readable as a PNG or PGM picture: {error}") from error
    pixels = np.asarray(image)
    # Modes that begin with I have 16 bits.
    pixels = pixels.astype(np.float32) / (65535.0 if image.mode.startswith("I") else 255.0)
    if pixels.ndim == 2:
        return pixels, None
    opacity = pixels[:, :, 3] if pixels.shape[2] == 4 else None
    return pixels[:, :, :3].mean(axis=2), opacity


def _cells(
    brightness: Floats,
    opacity: Floats | None,
    *,
    mode: str,
    negate: bool,
    occupied: float,
    free: float,
) -> Cells:
    """What map_server makes of pixels."""
    if mode == "raw":
        values = np.rint(brightness * 255.0)
        return np.where(values <= OCCUPIED, values, UNKNOWN).astype(np.int8)
    if mode == "trinary" and opacity is not None:
        brightness = (3.0 * brightness + opacity) / 4.0
    share = brightness if negate else 1.0 - brightness
    cells = np.full(share.shape, UNKNOWN, np.int8)
    if mode == "scale":
        cells[:] = np.rint((share - free) / (occupied - free) * 100.0).clip(FREE, OCCUPIED)
    cells[share < free] = FREE
    cells[share > occupied] = OCCUPIED
    if mode == "scale" and opacity is not None:
        cells[opacity < 1.0] = UNKNOWN
    return cells


def _floor(area: Map) -> tuple[Cells, float, Point]:
    """The cells, free inside of the mapped area and unknown around it, their size and corner."""
    sides = [high - low for low, high in zip(area.low, area.high, strict=True)]
    resolution = _DRAWN_RESOLUTION_M
    while (sides[0] / resolution) * (sides[1] / resolution) > _MOST_PIXELS / 4:
        resolution *= 2.0
    edge = round(_DRAWN_EDGE_M / resolution)
    columns, rows = (round(side / resolution) + 1 for side in sides)
    cells: Cells = np.full((rows + 2 * edge, columns + 2 * edge), UNKNOWN, np.int8)
    cells[edge : edge + rows, edge : edge + columns] = FREE
    # The area's border runs through the middle of pixels, and so do walls that stand on it.
    around = (edge + 0.5) * resolution
    return cells, resolution, (area.low[0] - around, area.low[1] - around)


def _draw_walls(cells: Cells, area: Map, resolution: float, low: Point) -> None:
    for wall in area.walls:
        length = math.dist((wall.x1, wall.y1), (wall.x2, wall.y2))
        count = 2 + int(4.0 * length / resolution)
        points = np.linspace((wall.x1, wall.y1), (wall.x2, wall.y2), count)
        columns, rows = np.floor((points - low) / resolution).astype(np.intp).T
        height, width = cells.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        cells[rows[inside], columns[inside]] = OCCUPIED
