"""The map of one robot as a picture for the page, with its marks."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from woosh_robot_agent.link import Body, ChassisClient, FrameError, LinkError, LinkState
from woosh_robot_agent.map_image import MapError, grey_png
from woosh_robot_agent.pb.robot.robot_pack_pb2 import BuildMapData
from woosh_robot_agent.pb.robot.robot_pb2 import Scene
from woosh_robot_agent.scene_map import scene_map
from woosh_robot_agent.tools.dashboard.part_data import marks_data

_RETRY_DELAY = 5.0
"""Delay before a failed request is retried, in seconds."""


@dataclass(frozen=True)
class MapPicture:
    """A map that the page shows.

    Attributes:
        png: the picture.
        data: resolution, origin and marks, for the page.
    """

    png: bytes
    data: dict[str, Any]


class MapSource:
    """Requests the map that the robot uses, and receives the one that it is making.

    Call `update` repeatedly while somebody watches.

    Args:
        chassis: the link.
        on_change: called when there is another picture.

    Attributes:
        picture: the picture; None if there is no map.
        number: number of the picture, which changes with each picture.
        error: reason why there is no picture; empty if there is one.
    """

    def __init__(self, chassis: ChassisClient, on_change: Callable[[], None]) -> None:
        self._chassis = chassis
        self._on_change = on_change
        self.picture: MapPicture | None = None
        self.number = 0
        self.error = ""
        self._shown: object = None
        """Scene, id, name and version of the map in the picture; None for another picture."""
        self._task: asyncio.Task[None] | None = None
        self._not_before = -math.inf
        """Loop time before which a map is not requested again."""
        self._unsubscribe: Callable[[], None] | None = None
        """Ends the subscription to the map that the robot is making."""

    def forget(self) -> None:
        """Forget the map, because another robot answers now."""
        self.close()
        self._shown = None
        self._set(None)

    def close(self) -> None:
        """Stop requesting and receiving."""
        if self._task is not None:
            self._task.cancel()
            self._task = None
        self._end_growing()

    def update(self, scene: Scene, mapping: bool) -> None:
        """Request the map if it is another one than that of the picture.

        Args:
            scene: scene and map that the robot uses.
            mapping: True while the robot is making a map.
        """
        if self._chassis.state is not LinkState.READY:
            return
        if mapping:
            self._shown = None
            if self._unsubscribe is None:
                self._unsubscribe = self._chassis.subscribe_raw(BuildMapData, self._growing)
            return
        self._end_growing()
        wanted = (scene.scene_name, scene.map_id, scene.map_name, scene.version)
        loop = asyncio.get_running_loop()
        busy = self._task is not None and not self._task.done()
        if not scene.scene_name or wanted == self._shown or busy or loop.time() < self._not_before:
            return
        self._not_before = loop.time() + _RETRY_DELAY
        self._start(self._request(wanted))

    async def _request(self, wanted: tuple[str, int, str, int]) -> None:
        try:
            area = await scene_map(self._chassis, *wanted[:3])
            self._set(await _picture(area.map_png, area.resolution, area.origin, marks_data(area)))
        except (LinkError, MapError) as error:
            if self.error != str(error):
                self.error = str(error)
                self._on_change()
            return
        self._shown = wanted
        self._not_before = -math.inf

    def _growing(self, body: Body) -> None:
        if self._task is None or self._task.done():  # a slow picture skips the next ones
            self._start(self._show_growing(body))

    async def _show_growing(self, body: Body) -> None:
        try:
            report: BuildMapData = body.message()
            origin = _Origin(report.origin_x, report.origin_y)
            self._set(await _picture(report.map_data, report.resolution, origin, []))
        except (FrameError, MapError):  # the next one comes within a second
            return

    def _end_growing(self) -> None:
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None

    def _start(self, work: Any) -> None:
        self._task = asyncio.get_running_loop().create_task(work, name="map picture")

    def _set(self, picture: MapPicture | None) -> None:
        self.picture = picture
        self.number += 1
        self.error = ""
        self._on_change()


@dataclass(frozen=True)
class _Origin:
    x: float
    y: float
    theta: float = 0.0


async def _picture(png: bytes, resolution: float, origin: Any, marks: list[Any]) -> MapPicture:
    """Return the picture of a map.

    Raises:
        MapError: the map has no valid resolution, origin or image.
    """
    if not 0.0 < resolution < math.inf:
        raise MapError(f"its resolution is invalid: {resolution:g}")
    if not all(map(math.isfinite, (origin.x, origin.y, origin.theta))):
        raise MapError(f"its origin is invalid: {origin}")
    # decoding a large image would block the link
    data = await asyncio.to_thread(grey_png, png)
    place = {"x": origin.x, "y": origin.y, "theta": origin.theta}
    return MapPicture(data, {"resolution": resolution, "origin": place, "marks": marks})
