"""Read maps of nav2's map_server: a picture (PNG, or plain or raw PGM) and a YAML file.

The keys of the YAML file have the same meaning as for map_server. Robots write such files without
`negate` and the thresholds.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from PIL import Image, UnidentifiedImageError

from woosh_robot_agent.data_files import Between, DataFileError, structure
from woosh_robot_agent.simulator.world.grid import Grid, KeepOut
from woosh_robot_agent.simulator.world.growing_grid import FREE, OCCUPIED, UNKNOWN, Cells

_MAX_PIXELS = 4096 * 4096
"""Maximum size of a picture: 200 x 200 m with pixels of 5 cm. Computing the distance fields then
takes some seconds."""

Shades: TypeAlias = npt.NDArray[np.float32]
"""A brightness or opacity from 0 to 1 for each pixel; the first row has the greatest y."""


class _Origin(NamedTuple):
    """Pose of the lower left corner of the picture, in metres and radians."""

    x: float
    y: float
    yaw: float


@dataclass(frozen=True)
class _Description:
    """The YAML file of a map, with the keys of nav2's map_server."""

    image: str
    resolution: Annotated[float, Between(0.001, 10)]
    origin: _Origin
    negate: Literal[0, 1] = 0
    occupied_thresh: float = 0.65
    free_thresh: float = 0.196
    mode: Literal["trinary", "scale", "raw"] = "trinary"

    def __post_init__(self) -> None:
        if self.origin.yaw:
            raise ValueError(
                "origin: a rotated map is not supported: rotate the picture and set yaw to 0"
            )
        if not 0.0 <= self.free_thresh < self.occupied_thresh <= 1.0:
            raise ValueError(
                f"free_thresh ({self.free_thresh:g}) must be at least 0 and less than "
                f"occupied_thresh ({self.occupied_thresh:g}), which must be at most 1"
            )


def read_grid(name: str, content: Any, read: Callable[[str], bytes]) -> Grid:
    """Return the grid that a YAML file of map_server describes.

    Args:
        name: path of the YAML file, for errors.
        content: content of the YAML file. Unknown keys are ignored, as by map_server.
        read: returns the content of the picture, whose path is relative to the YAML file's folder,
            or raises `DataFileError`.
    """
    description = structure(_Description, content, name, known_only=False)
    picture = str(PurePosixPath(name).parent / description.image)
    cells = _cells(*read_pixels(picture, read(description.image)), description)
    # The first row of a picture has the greatest y.
    low = description.origin.x, description.origin.y
    return Grid(np.ascontiguousarray(cells[::-1]), description.resolution, low)


def read_keepout(name: str, data: bytes, grid: Grid) -> KeepOut:
    """Return the cells of a grid that a picture marks as keep-out areas.

    Args:
        name: path of the picture, for errors.
        data: the picture, in which keep-out areas are dark, as in the masks of nav2.
        grid: the grid of the map, with one cell for each pixel of the picture.
    """
    # The picture has no YAML file, so the thresholds are the defaults of map_server.
    description = _Description(name, grid.resolution, _Origin(*grid.low, 0.0))
    # The first row of a picture has the greatest y, that of a grid the smallest.
    cells = _cells(*read_pixels(name, data), description)[::-1]
    if cells.shape != grid.cells.shape:
        height, width = grid.cells.shape
        raise DataFileError(
            f"{name}: {cells.shape[1]} x {cells.shape[0]} pixels, but the map has "
            f"{width} x {height}: save it in the size of the map"
        )
    return np.ascontiguousarray(cells == OCCUPIED)


def read_pixels(name: str, data: bytes) -> tuple[Shades, Shades | None]:
    """Return brightness and opacity of each pixel; no opacity if the picture has no transparency.

    Args:
        name: path of the picture, for errors.
        data: content of the file.
    """
    try:
        image: Image.Image = Image.open(io.BytesIO(data), formats=("PNG", "PPM"))
        width, height = image.size
        if not 0 < width * height <= _MAX_PIXELS:
            raise DataFileError(
                f"{name}: {width} x {height} pixels are not within 1 to {_MAX_PIXELS}: split the "
                "map into several ones, or use larger pixels"
            )
        image.load()
        if "transparency" in image.info or "A" in image.getbands():
            image = image.convert("RGBA")
        elif image.mode == "P":
            image = image.convert("RGB")
        elif image.mode == "1":
            image = image.convert("L")
    except DataFileError:
        raise
    except UnidentifiedImageError:  # its text names the buffer, not the file
        raise DataFileError(
            f"{name}: not readable as a PNG or PGM picture: save it again as one of them"
        ) from None
    except Exception as error:  # Pillow raises errors of any type
        raise DataFileError(f"{name}: not readable as a PNG or PGM picture: {error}") from error
    pixels = np.asarray(image)
    # Modes that begin with I have 16 bits per pixel.
    pixels = pixels.astype(np.float32) / (65535.0 if image.mode.startswith("I") else 255.0)
    if pixels.ndim == 2:
        return pixels, None
    opacity = pixels[:, :, 3] if pixels.shape[2] == 4 else None
    return pixels[:, :, :3].mean(axis=2), opacity


def _cells(brightness: Shades, opacity: Shades | None, description: _Description) -> Cells:
    """Convert pixels to cells as map_server does.

    Args:
        brightness: value of each pixel, from 0 (black) to 1 (white).
        opacity: value of each pixel, from 0 to 1; None for a picture without transparency.
        description: mode and thresholds of the conversion.
    """
    mode, negate = description.mode, description.negate
    occupied, free = description.occupied_thresh, description.free_thresh
    if mode == "raw":
        values = np.rint(brightness * 255.0)
        return np.where(values <= OCCUPIED, values, UNKNOWN).astype(np.int8)
    if mode == "trinary" and opacity is not None:  # for map_server, opacity is a fourth colour
        brightness = (3.0 * brightness + opacity) / 4.0
    occupancy = brightness if negate else 1.0 - brightness
    cells = np.full(occupancy.shape, UNKNOWN, np.int8)
    if mode == "scale":
        cells[:] = np.rint((occupancy - free) / (occupied - free) * 100.0).clip(FREE, OCCUPIED)
    cells[occupancy < free] = FREE
    cells[occupancy > occupied] = OCCUPIED
    if mode == "scale" and opacity is not None:
        cells[opacity < 1.0] = UNKNOWN
    return cells
