"""The image of a chassis's map as an occupancy grid.

A pixel is occupied, free or unknown by its shade of grey, with the thresholds of nav2's map_server.
"""

from __future__ import annotations

import array
import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # loads slowly, and is needed only for maps
    from PIL import Image

_FORMATS = ("PNG", "PPM", "BMP", "JPEG")
"""Formats of images that are read: that of the robots, and those of map_server.

Pillow starts other programs for some of its other formats.
"""
OCCUPIED_THRESHOLD = 0.65
"""Darkness above which a cell is occupied, as in map_server."""
FREE_THRESHOLD = 0.196
"""Darkness below which a cell is free, as in map_server."""
_MAX_CELLS = 100_000_000
"""Maximum size of a map, in cells."""
_CELLS = bytes(
    100
    if (255 - grey) / 255 > OCCUPIED_THRESHOLD
    else 0
    if (255 - grey) / 255 < FREE_THRESHOLD
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
    from PIL import ImageOps

    grey = ImageOps.flip(grey_image(image_file))
    return grey.width, grey.height, array.array("b", grey.tobytes().translate(_CELLS))


def grey_png(image_file: bytes) -> bytes:
    """Return a map's image as a PNG with 256 shades of grey; unchanged if it is one.

    Raises:
        MapError: the image cannot be decoded, or is too large.
    """
    from PIL import Image

    grey = grey_image(image_file)
    with Image.open(io.BytesIO(image_file)) as image:
        if image.format == "PNG" and image.mode == "L" and "transparency" not in image.info:
            return image_file
    buffer = io.BytesIO()
    grey.save(buffer, "PNG")
    return buffer.getvalue()


def grey_image(image_file: bytes) -> Image.Image:
    """Return a map's image in 256 shades of grey.

    Raises:
        MapError: the image cannot be decoded, or is too large.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(image_file), formats=_FORMATS) as image:
            if image.width * image.height > _MAX_CELLS:
                raise MapError(f"its image is too large: {image.width} x {image.height} pixels")
            grey: Image.Image = image.convert("L")
            return grey
    except MapError:
        raise
    except UnidentifiedImageError:  # its text names the buffer
        formats = ", ".join(_FORMATS)
        raise MapError(f"its image cannot be decoded: it is none of {formats}") from None
    except Exception as error:  # Pillow raises errors of many types for damaged files
        raise MapError(f"its image cannot be decoded: {error}") from None
