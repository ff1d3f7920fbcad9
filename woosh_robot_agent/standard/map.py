"""map: the image of the chassis's map as an occupancy grid."""

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
from woosh_robot_agent.standard.part import Part
from woosh_robot_agent.standard.part_context import PartContext
from woosh_robot_agent.standard.pose2d import Pose2D
from woosh_robot_agent.standard.pose_messages import to_pose
from woosh_robot_agent.standard.subscribers import Subscribers

_LOG = logging.getLogger(__name__)
_CHECK_RATE = 2.0
"""Rate of checking if the map has to be requested, in Hz."""
_RETRY_DELAY = 10.0
"""Delay before a failed request is retried, in seconds."""
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


class Map(Part):
    """Publishes map on the first subscription, and when the scene, map or version changes.

    A map can have many MiB, so it is requested only on demand. Failed requests are retried.
    """

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._log = LogOnce(_LOG)
        self._subscribers = Subscribers(context)
        self._publisher = self._subscribers.publisher("map")
        self._wanted: tuple[str, int, str, int] | None = None
        """Scene, map id, map name and version that the robot uses; None if unknown."""
        self._published: tuple[str, int, str, int] | None = None
        """The same of the published map."""
        self._not_before = -math.inf
        """Loop time before which the map is not requested again."""
        self._robot = object()
        """Stands for the current robot."""
        context.robot.chassis.on_robot_changed(self._forget)
        context.robot.chassis.on_snapshot(self._snapshot)
        context.robot.chassis.subscribe(Scene, self._scene)

    async def run(self) -> None:
        async for now in self._subscribers.times(lambda: _CHECK_RATE):
            ready = self._context.robot.chassis.state is LinkState.READY
            stale = self._wanted != self._published and now >= self._not_before
            if ready and stale:
                await self._update(now)

    def _snapshot(self, info: RobotInfo) -> None:
        if info.HasField("scene"):
            self._scene(info.scene)

    def _forget(self) -> None:
        self._wanted = self._published = None
        self._robot = object()
        self._log.clear()

    def _scene(self, scene: Scene) -> None:
        self._wanted = (scene.scene_name, scene.map_id, scene.map_name, scene.version)
        self._not_before = -math.inf

    async def _update(self, now: float) -> None:
        wanted, robot = self._wanted, self._robot
        assert wanted is not None
        scene_name, map_id, map_name, _ = wanted
        try:
            data = await self._request(scene_name)
            area = _find(data, map_id, map_name)
            # decoding a large image would block the link
            width, height, cells = await asyncio.to_thread(cells_of, area.map_png)
        except (LinkError, MapError) as error:
            self._log.warn("map", f"no map: {error}")
            self._not_before = now + _RETRY_DELAY
            return
        if robot is not self._robot:
            return
        self._log.clear()
        message = OccupancyGrid(data=cells)
        message.header.stamp = message.info.map_load_time = self._context.now()
        message.header.frame_id = self._context.frame("map")
        message.info.resolution = area.resolution
        message.info.width, message.info.height = width, height
        message.info.origin = to_pose(Pose2D.from_message(area.origin))
        self._publisher.publish(message)
        self._published = wanted

    async def _request(self, scene_name: str) -> SceneData:
        answer = await self._context.robot.chassis.request(SceneData(name=scene_name))
        if not answer.ok:
            raise MapError(f"the chassis refused SceneData of {scene_name}: {answer.msg}")
        if not isinstance(answer.body, SceneData):
            raise MapError(f"the chassis sent no SceneData: {answer.defect or answer.type}")
        return answer.body


def _find(data: SceneData, map_id: int, map_name: str) -> SceneData.Map:
    """Return the current map.

    Raises:
        MapError: it is missing, or has no image or no valid resolution.
    """
    found = [each for each in data.maps if each.name == map_name] or [
        each for each in data.maps if each.id == map_id
    ]
    if not found:
        raise MapError(f"SceneData of {data.name} has no map {map_name} ({map_id})")
    area = found[0]
    if not area.map_png:
        raise MapError(f"map {area.name} has no image")
    if not 0.0 < area.resolution < math.inf:
        raise MapError(f"map {area.name} has an invalid resolution: {area.resolution:g}")
    return area


def cells_of(image_file: bytes) -> tuple[int, int, array.array[int]]:
    """Return width, height and cells of a map's image, as in nav_msgs/OccupancyGrid.

    Raises:
        MapError: the image cannot be decoded, or is too large.
    """
    from PIL import Image, UnidentifiedImageError  # needed only for maps

    try:
        with Image.open(io.BytesIO(image_file)) as image:
            if image.width * image.height > _MAX_CELLS:
                raise MapError(f"its image is too large: {image.width} x {image.height} pixels")
            grey: Any = image.convert("L").transpose(Image.Transpose.FLIP_TOP_BOTTOM)
    except (UnidentifiedImageError, OSError, Image.DecompressionBombError, SyntaxError) as error:
        raise MapError(f"its image cannot be decoded: {error}") from None
    return grey.width, grey.height, array.array("b", grey.tobytes().translate(_CELLS))
