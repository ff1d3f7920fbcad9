"""Maps in a recording: a view of the current map, and attachments that map_server can load."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator
from typing import NamedTuple

from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from google.protobuf.message import Message

from woosh_robot_agent.map_image import MapError, grey_image
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pack_pb2 import BuildMapData
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, Scene
from woosh_robot_agent.tools.nav2_map import map_files
from woosh_robot_agent.tools.recording.channel import protobuf_channel
from woosh_robot_agent.tools.recording.views import MAP_FRAME, View, pose, timestamp

_LOG = logging.getLogger(__name__)
_GRID = protobuf_channel("/view/map", Grid)
_COLOURS = ("red", "green", "blue", "alpha")
"""Fields of a cell: with these names, viewers show the colours without configuration."""
_MAX_CELLS = 9_000_000
"""Size of a map above which it has no view, in cells; it is attached all the same.

Compressing it would block the proxy for too long.
"""


class Picture(NamedTuple):
    """The image of a map, and where it belongs.

    Attributes:
        name: Name of the map.
        image: Image file.
        resolution: Size of a pixel, in metres.
        origin: Pose of the bottom left corner: x and y in metres, angle in radians.
        area: The map as the chassis sent it; None for one that the robot is making.
        is_current: True for the map that the robot uses, or is making.
    """

    name: str
    image: bytes
    resolution: float
    origin: tuple[float, float, float]
    area: SceneData.Map | None
    is_current: bool


class PreparedMap(NamedTuple):
    """A map in the form in which it is written.

    Attributes:
        name: Name of the map.
        files: Contents of the files for map_server, by name.
        view: View of the map; None if it is not the current one, or too large.
    """

    name: str
    files: dict[str, bytes]
    view: View | None

    def attachments(self) -> Iterator[tuple[str, str, bytes]]:
        """Yield name, media type and content of the attachments."""
        for name, content in self.files.items():
            yield name, "image/png" if name.endswith(".png") else "application/yaml", content


class MapFinder:
    """Finds maps in the messages of the chassis."""

    def __init__(self) -> None:
        self._current = ("", 0)
        """Name and id of the current map."""

    def pictures_of(self, message: Message) -> Iterator[Picture]:
        """Yield the maps in a message."""
        if isinstance(message, RobotInfo) and message.HasField("scene"):
            message = message.scene
        if isinstance(message, Scene):
            self._current = message.map_name, message.map_id
        elif isinstance(message, BuildMapData):
            origin = (message.origin_x, message.origin_y, 0.0)
            name = "in the making"
            yield Picture(name, message.map_data, message.resolution, origin, None, True)
        elif isinstance(message, SceneData):
            for area in message.maps:
                if area.map_png:
                    at = area.origin
                    yield Picture(
                        area.name,
                        area.map_png,
                        area.resolution,
                        (at.x, at.y, at.theta),
                        area,
                        (area.name, area.id) == self._current or len(message.maps) == 1,
                    )


def prepare_map(picture: Picture, time: int) -> PreparedMap | None:
    """Return a map in the form in which it is written; None if it is not usable, which is logged.

    Decoding a large image takes long: call it in a thread of its own.

    Args:
        picture: The map.
        time: Time of recording, in ns.
    """
    try:
        numbers = (picture.resolution, *picture.origin)
        if not all(map(math.isfinite, numbers)) or picture.resolution <= 0:
            raise MapError(f"its resolution or origin is invalid: {numbers}")
        files = {}
        if picture.area is not None:
            files = map_files(picture.area, re.sub(r"[^\w.-]", "_", picture.name))
        return PreparedMap(
            picture.name, files, _view(picture, time) if picture.is_current else None
        )
    except MapError as error:
        _LOG.warning("map %s is left out: %s", picture.name, error)
        return None


def _view(picture: Picture, time: int) -> View | None:
    from PIL import ImageOps

    grey = grey_image(picture.image)
    if grey.width * grey.height > _MAX_CELLS:
        _LOG.warning("map %s is too large for a view; it is attached only", picture.name)
        return None
    colours = ImageOps.flip(grey).convert("RGBA").tobytes()
    fields = [
        PackedElementField(name=name, offset=offset, type=PackedElementField.UINT8)
        for offset, name in enumerate(_COLOURS)
    ]
    x, y, theta = picture.origin
    grid = Grid(
        timestamp=timestamp(time),
        frame_id=MAP_FRAME,
        pose=pose(x, y, theta),
        column_count=grey.width,
        cell_size=Vector2(x=picture.resolution, y=picture.resolution),
        row_stride=len(_COLOURS) * grey.width,
        cell_stride=len(_COLOURS),
        fields=fields,
        data=colours,
    )
    return View(_GRID, grid)
