"""Images of maps as the cells of an occupancy grid."""

from __future__ import annotations

import array
import io
from typing import Any

_FORMATS = ("PNG", "PPM", "BMP", "JPEG")
"""Formats of images that are read. Robots send PNG, and map_server uses the others. Pillow knows
more formats; for some of them it starts other programs."""
_MAX_CELLS = 100_000_000
"""Maximum size of a map, in cells."""
_OCCUPIED_THRESHOLD = 0.65
"""Darkness above which a cell is occupied, as in map_server."""
_FREE_THRESHOLD = 0.196
"""Darkness below which a cell is free, as in map_server."""
_CELLS = bytes(
    100
    if (255 - grey) / 255 > _OCCUPIED_THRESHOLD
    else 0
    if (255 - grey) / 255 < _FREE_THRESHOLD
    else 255
    for grey in range(256)
)
"""Value of a cell by its shade of grey; 255 stands for -1, unknown."""


class MapError(ValueError):
    """The chassis sent no usable map; the text says why."""


def cells_of(image_file: bytes) -> tuple[int, int, array.array[int]]:
    """Return width, height and cells of a map's image, as in nav_msgs/OccupancyGrid.

    Raises:
        MapError: the image cannot be decoded, or is too large.
    """
    from PIL import Image  # needed only for maps

    try:
        with Image.open(io.BytesIO(image_file), formats=_FORMATS) as image:
            if image.width * image.height > _MAX_CELLS:
                raise MapError(f"its image is too large: {image.width} x {image.height} pixels")
            grey: Any = image.convert("L").transpose(Image.Transpose.FLIP_TOP_BOTTOM)
    except MapError:
        raise
    except Exception as error:  # Pillow raises errors of many types for damaged files
        raise MapError(f"its image cannot be decoded: {error}") from None
    return grey.width, grey.height, array.array("b", grey.tobytes().translate(_CELLS))
