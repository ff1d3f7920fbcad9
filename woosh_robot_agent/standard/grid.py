"""map: the picture of the chassis's map as an occupancy grid."""

from __future__ import annotations

import array
import asyncio
import io
import logging
import math
from typing import Any

from nav_msgs.msg import OccupancyGrid

from woosh_robot_agent.link import LinkError, LinkState
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, Scene
from woosh_robot_agent.standard.audience import Audience
from woosh_robot_agent.standard.part_context import Part, PartContext
from woosh_robot_agent.standard.plane import Plane
from woosh_robot_agent.standard.stamped import pose_of

_LOG = logging.getLogger(__name__)
_RATE_HZ = 2.0
_RETRY_S = 10.0
_MOST_CELLS = 100_000_000

# As map_server has it: dark is occupied, light is free, grey from 205 down is unknown.
_OCCUPIED, _FREE = 0.65, 0.196
_CELLS = bytes(
    100 if (255 - grey) / 255 > _OCCUPIED else 0 if (255 - grey) / 255 < _FREE else 255
    for grey in range(256)
)
"""The cell of each shade of grey; 255 is -1, unknown."""


class MapError(ValueError):
    """A map's picture cannot be used; the text says why."""


class Grid(Part):
    """Publishes map, once somebody subscribes, and again when scene, map or version change.

    A map can have many MiB, so it is not asked for before. What did not work is tried again.
    """

    def __init__(self, host: PartContext) -> None:
        self._host = host
        self._log = LogOnce(_LOG)
        self._audience = Audience(host)
        self._map = self._audience.publisher("map")
        self._wanted: tuple[str, int, str, int] | None = None
        self._published: tuple[str, int, str, int] | None = None
        self._not_before = -math.inf
        host.chassis.on_snapshot(self._snapshot)
        host.chassis.subscribe(Scene, self._scene)

    async def run(self) -> None:
        """See `Part.run`: ask when there is need to."""
        async for now in self._audience.times(lambda: _RATE_HZ):
            ready = self._host.chassis.state is LinkState.READY
            stale = self._wanted != self._published and now >= self._not_before
            if ready and stale:
                await self._renew(now)

    def _snapshot(self, info: RobotInfo) -> None:
        if info.HasField("scene"):
            self._scene(info.scene)

    def _scene(self, scene: Scene) -> None:
        self._wanted = (scene.scene_name, scene.map_id, scene.map_name, scene.version)
        self._not_before = -math.inf

    async def _renew(self, now: float) -> None:
        wanted = self._wanted
        assert wanted is not None
        scene_name, map_id, map_name, _ = wanted
        try:
            data = await self._ask(scene_name)
            area = _find(data, map_id, map_name)
            # a big picture takes longer to read than the link may be kept waiting
            width, height, cells = await asyncio.to_thread(cells_of, area.map_png)
        except (LinkError, MapError) as error:
            self._log.warn("map", f"no map: {error}")
            self._not_before = now + _RETRY_S
            return
        self._log.clear()
        message = OccupancyGrid(data=cells)
        message.header.stamp = message.info.map_load_time = self._host.now()
        message.header.frame_id = self._host.frame("map")
        message.info.resolution = area.resolution
        message.info.width, message.info.height = width, height
        message.info.origin = pose_of(Plane.of(area.origin))
        self._map.publish(message)
        self._published = wanted

    async def _ask(self, scene_name: str) -> SceneData:
        answer = await self._host.chassis.request(SceneData(name=scene_name))
        if not answer.ok:
            raise MapError(f"the chassis refused SceneData of {scene_name}: {answer.msg}")
        if not isinstance(answer.body, SceneData):
            raise MapError(f"the chassis gave no SceneData: {answer.defect or answer.type}")
        return answer.body


def _find(data: SceneData, map_id: int, map_name: str) -> SceneData.Map:
    """The map in use.

    Raises:
        MapError: It is not there, or has no picture or scale.
    """
    found = [each for each in data.maps if each.name == map_name] or [
        each for each in data.maps if each.id == map_id
    ]
    if not found:
        raise MapError(f"SceneData of {data.name} has no map {map_name} ({map_id})")
    area = found[0]
    if not area.map_png:
        raise MapError(f"map {area.name} has no picture")
    if not 0.0 < area.resolution < math.inf:
        raise MapError(f"map {area.name} has the resolution {area.resolution:g}")
    return area


def cells_of(picture: bytes) -> tuple[int, int, array.array[int]]:
    """Width, height and cells of a map's picture, as in nav_msgs/OccupancyGrid: south row first.

    Raises:
        MapError: It is no picture, or too big.
    """
    from PIL import Image, UnidentifiedImageError  # not everybody wants maps

    try:
        with Image.open(io.BytesIO(picture)) as image:
            if image.width * image.height > _MOST_CELLS:
                raise MapError(f"its picture of {image.width} x {image.height} pixels is too big")
            grey: Any = image.convert("L").transpose(Image.Transpose.FLIP_TOP_BOTTOM)
    except (UnidentifiedImageError, OSError, Image.DecompressionBombError, SyntaxError) as error:
        raise MapError(f"its picture cannot be read: {error}") from None
    return grey.width, grey.height, array.array("b", grey.tobytes().translate(_CELLS))
