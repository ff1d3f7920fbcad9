"""The map that a robot uses, and its image as an occupancy grid.

A pixel is occupied, free or unknown by its shade of grey, with the thresholds of nav2's map_server.
"""

from __future__ import annotations

import array
import io
import math
from typing import TYPE_CHECKING

from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.sentences import Sentence

if TYPE_CHECKING:  # loads slowly, and is needed only for maps
    from PIL import Image

_TOO_LARGE = Sentence("its image is too large: {width} x {height} pixels")
_NO_FORMAT = Sentence("its image cannot be decoded: it is none of {formats}")
_DAMAGED = Sentence("its image cannot be decoded: {error}")
_RESOLUTION = Sentence("its resolution is invalid: {value}")
_ORIGIN = Sentence("its origin is not finite: {values}")
_NONE_SENT = Sentence("the robot sent no image")
_REFUSED = Sentence("the chassis refused SceneData of {scene}: {reason}")
_NO_SCENE = Sentence("the chassis sent no SceneData: {reason}")
_MISSING = Sentence("SceneData of {scene} has no map {map} ({id})")
_NO_IMAGE = Sentence("map {map} has no image")
_FORMATS = ("PNG", "PPM", "BMP", "JPEG")
"""Formats of images that are read: PNG of robots, and the formats of map_server.

Pillow starts other programs for some of its other formats.
"""
OCCUPIED_THRESHOLD = 0.65
"""Darkness above which a cell is occupied, as in map_server."""
FREE_THRESHOLD = 0.196
"""Darkness below which a cell is free, as in map_server."""
_MAX_CELLS = 100_000_000
"""Maximum size of a map, in cells."""


def _cell(grey: int) -> int:
    """Return the value of a cell by its shade of grey; 255 stands for -1, unknown."""
    darkness = (255 - grey) / 255
    if darkness > OCCUPIED_THRESHOLD:
        return 100
    return 0 if darkness < FREE_THRESHOLD else 255


_CELLS = bytes(map(_cell, range(256)))
"""Values of cells by shade of grey, as a table for `bytes.translate`."""


class MapError(ValueError):
    """The chassis sent no usable map; the text says why."""


def cells_of(image_file: bytes) -> tuple[int, int, array.array[int]]:
    """Return width, height and cells of a map's image; the cells as in nav_msgs/OccupancyGrid.

    Raises:
        MapError: the image cannot be decoded, or is too large.
    """
    from PIL import ImageOps

    grey = ImageOps.flip(grey_image(image_file))  # a grid begins with the row at the bottom
    return grey.width, grey.height, array.array("b", grey.tobytes().translate(_CELLS))


def grey_png(image_file: bytes) -> bytes:
    """Return a map's image as a PNG with 256 shades of grey; unchanged if it is such a PNG.

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
                raise MapError(_TOO_LARGE(width=image.width, height=image.height))
            if image.mode.startswith("I"):  # 16 bits, which Pillow would clip to 8
                image = image.convert("I").point(lambda value: value * (1 / 257))
            grey: Image.Image = image.convert("L")
            return grey
    except MapError:
        raise
    except UnidentifiedImageError:  # its own text names the buffer object, not the defect
        raise MapError(_NO_FORMAT(formats=", ".join(_FORMATS))) from None
    except Exception as error:  # Pillow raises errors of many types for damaged files
        raise MapError(_DAMAGED(error=str(error))) from None


def check_resolution_and_origin(resolution: float, *origin: float) -> None:
    """Check the resolution of a map and the numbers of its origin.

    Raises:
        MapError: a value is not possible.
    """
    if not 0.0 < resolution < math.inf:
        raise MapError(_RESOLUTION(value=f"{resolution:g}"))
    if not all(map(math.isfinite, origin)):
        raise MapError(_ORIGIN(values=", ".join(f"{each:g}" for each in origin)))


def map_files(area: SceneData.Map, image: bytes, stem: str) -> dict[str, bytes]:
    """Return the YAML file and the PNG of an image of a map for nav2's map_server, by name.

    Loaded by map_server, the image equals the agent's topic `map` or `keepout_mask`.

    Args:
        area: the map.
        image: its field `map_png` or `keepout_png`, as the robot sent it.
        stem: name of the files without suffix.

    Raises:
        MapError: the image, the resolution or the origin is missing, or cannot be used.
    """
    import numpy
    import yaml

    if not image:
        raise MapError(_NONE_SENT())
    png, origin = grey_png(image), area.origin
    check_resolution_and_origin(area.resolution, origin.x, origin.y, origin.theta)
    numbers = (area.resolution, origin.x, origin.y, origin.theta)
    # the chassis sends numbers of 32 bits: 0.05, not 0.0500000007
    resolution, *coordinates = (float(str(numpy.float32(number))) for number in numbers)
    description = {
        "image": f"{stem}.png",
        "mode": "trinary",
        "resolution": resolution,
        "origin": coordinates,
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESHOLD,
        "free_thresh": FREE_THRESHOLD,
    }
    text = yaml.safe_dump(description, sort_keys=False, allow_unicode=True, default_flow_style=None)
    return {f"{stem}.yaml": text.encode(), f"{stem}.png": png}


async def scene_data(chassis: ChassisClient, scene_name: str) -> SceneData:
    """Request a scene with all of its maps, which can have many MiB.

    Raises:
        LinkError: there is no answer from the chassis.
        MapError: the chassis refuses, or sends something else.
    """
    answer = await chassis.request(SceneData(name=scene_name))
    if not answer.ok:
        raise MapError(_REFUSED(scene=scene_name, reason=answer.reason))
    if not isinstance(answer.body, SceneData):
        raise MapError(_NO_SCENE(reason=answer.defect or answer.type))
    return answer.body


def find_map(data: SceneData, map_id: int, map_name: str) -> SceneData.Map:
    """Return a map of a scene.

    Args:
        data: the scene with all of its maps.
        map_id: id of the map, used if no map has the name.
        map_name: name of the map.

    Raises:
        MapError: the map is missing, or has no image.
    """
    found = [each for each in data.maps if each.name == map_name] or [
        each for each in data.maps if each.id == map_id
    ]
    if not found:
        raise MapError(_MISSING(scene=data.name, map=map_name, id=map_id))
    if not found[0].map_png:
        raise MapError(_NO_IMAGE(map=found[0].name))
    return found[0]
