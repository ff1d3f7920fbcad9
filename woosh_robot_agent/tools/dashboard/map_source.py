"""The map of a robot as the page shows it: picture, keep-out areas, marks and zones."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from woosh_robot_agent.link import Body, ChassisClient, FrameError, LinkError, LinkState
from woosh_robot_agent.link.reconnect import Backoff
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneList
from woosh_robot_agent.pb.robot.robot_pack_pb2 import BuildMapData
from woosh_robot_agent.pb.robot.robot_pb2 import RobotState, Scene
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.robot import maps
from woosh_robot_agent.sentences import Sentence, said_by
from woosh_robot_agent.tools.dashboard import part_data
from woosh_robot_agent.tools.dashboard.texts import value_data
from woosh_robot_agent.tools.robot_view import RobotView

_NO_KEEPOUT = Sentence("the keep-out areas are not shown: {reason}")
_RETRY_DELAY = 5.0
"""Delay before a failed request is retried, in seconds. It doubles each time: a map may be too
large for the link, or exceed `max_frame_size`, which costs the link."""
_MAX_RETRY_DELAY = 300.0
"""Longest such delay, in seconds."""
_LIST_PERIOD = 20.0
"""Time between two requests for the list of scenes, in seconds."""


@dataclass(frozen=True)
class MapPicture:
    """A map that the page shows.

    Attributes:
        png: the picture.
        keepout_png: picture of the same size in which keep-out areas are dark; empty without them.
        problem: why the keep-out areas cannot be shown; empty without a problem.
        data: everything else for the page, e.g. resolution, origin, marks and zones. A map that the
            robot is making has no names, marks and zones.
    """

    png: bytes
    keepout_png: bytes
    problem: str
    data: dict[str, Any]

    def shows(self, scene: Scene) -> bool:
        """Return True if this is the map that a robot uses; False for a map that is being made."""
        shown = tuple(map(self.data.get, ("scene", "name", "version")))
        return shown == (scene.scene_name, scene.map_name, str(scene.version))


class MapSource:
    """Requests the map that the robot uses, and receives the map that the robot is making.

    Call `update` repeatedly while somebody watches, then `end_subscription`.

    Args:
        view: state of the robot.
        on_change: called when the picture, the error or the list of scenes has changed.

    Attributes:
        picture: the last map that was received; None before the first. The robot may have changed
            to another map since.
        number: number of pictures so far, which identifies the picture.
        error: why the last request of a map failed; empty if it did not.
    """

    def __init__(
        self, chassis: ChassisClient, view: RobotView, on_change: Callable[[], None]
    ) -> None:
        self._chassis = chassis
        self._view = view
        self._on_change = on_change
        self.picture: MapPicture | None = None
        self.number = 0
        self.error = ""
        self._shown: object = None
        """Scene, id, name and version of `picture`.

        None if there is no picture, if it may be outdated, or if it shows a map that the robot is
        making.
        """
        self._picture_task: asyncio.Task[None] | None = None
        """Request of a map, or conversion of the picture of a map that the robot is making."""
        self._wanted: object = None
        """Scene, id, name and version of the map that was wanted last.

        None while the robot makes a map.
        """
        self._retry = Backoff(_RETRY_DELAY, _MAX_RETRY_DELAY)
        """Delays after failed requests for `_wanted`."""
        self._not_before = -math.inf
        """Loop time before which `_wanted` is not requested again."""
        self._unsubscribe: Callable[[], None] | None = None
        """Ends the subscription to the map that the robot is making."""
        self._scenes: list[SceneList.Scene] = []
        self._scenes_task: asyncio.Task[None] | None = None
        self._scenes_due = -math.inf
        """Loop time from which the list of scenes is requested again."""
        chassis.on_snapshot(lambda _: self._forget())
        chassis.subscribe(RobotState, self._state_reported)

    @property
    def _is_mapping(self) -> bool:
        """True while the robot is making a map."""
        return self._view.info.state == robot.kMapping

    def data(self) -> dict[str, Any]:
        """Return the data of the part `map` of the page."""
        picture, scene = self.picture, self._view.info.scene
        # a picture of another map is not shown
        if picture is None or not (self._is_mapping or picture.shows(scene)):
            return {"number": self.number, "error": value_data(self.error)}
        error = self.error or picture.problem
        return {"number": self.number, "error": value_data(error), **picture.data}

    def scenes_data(self) -> list[dict[str, Any]]:
        """Return the data of the part `scenes` of the page."""
        return [{"name": each.name, "maps": list(each.maps)} for each in self._scenes]

    def close(self) -> None:
        """Stop requesting and receiving."""
        for task in (self._picture_task, self._scenes_task):
            if task is not None:
                task.cancel()
        self._picture_task = self._scenes_task = None
        self.end_subscription()

    def update(self) -> None:
        """Request the map and the list of scenes if they are due.

        While the robot is making a map, subscribe to that map instead.
        """
        if self._chassis.state is not LinkState.READY:
            return
        self._update_scenes()
        if self._is_mapping:
            self._shown = self._wanted = None
            if self._unsubscribe is None:
                self._unsubscribe = self._chassis.subscribe_raw(BuildMapData, self._map_grown)
            return
        self.end_subscription()
        scene = self._view.info.scene
        wanted = (scene.scene_name, scene.map_id, scene.map_name, scene.version)
        if wanted != self._wanted:
            self._wanted, self._not_before = wanted, -math.inf
            self._retry.reset()
        if not scene.scene_name or wanted == self._shown:
            self._set_error("")  # an error may be left from another map
            return
        is_busy = self._picture_task is not None and not self._picture_task.done()
        if not is_busy and asyncio.get_running_loop().time() >= self._not_before:
            self._start_picture_task(self._request_map(wanted))

    def _state_reported(self, report: RobotState) -> None:
        if report.state == robot.kMapping:
            self._forget()

    def _forget(self) -> None:
        """Request the map again: the robot may make a new one with the same version."""
        self._shown = None

    def _update_scenes(self) -> None:
        loop = asyncio.get_running_loop()
        is_busy = self._scenes_task is not None and not self._scenes_task.done()
        if is_busy or loop.time() < self._scenes_due:
            return
        self._scenes_due = loop.time() + _LIST_PERIOD
        self._scenes_task = loop.create_task(self._request_scenes(), name="scenes")

    async def _request_scenes(self) -> None:
        try:
            answer = await self._chassis.request(SceneList())
        except LinkError:
            return  # the page shows the state of the link
        if answer.ok and isinstance(answer.body, SceneList):
            self._scenes = list(answer.body.scenes)
            self._on_change()

    async def _request_map(self, wanted: tuple[str, int, str, int]) -> None:
        scene_name, map_id, map_name, version = wanted
        try:
            scene = await maps.scene_data(self._chassis, scene_name)
            area = maps.find_map(scene, map_id, map_name)
            origin = area.origin.x, area.origin.y, area.origin.theta
            content = {
                "scene": scene_name,
                "name": map_name,
                "version": str(version),
                "marks": part_data.marks_data(area),
                "zones": part_data.zones_data(area),
                "lanes": part_data.lanes_data(area),
                "taskTypes": part_data.task_types_data(scene),
            }
            png, keepout = area.map_png, area.keepout_png
            self._set_picture(await _picture(png, keepout, area.resolution, origin, content))
        except (LinkError, maps.MapError) as error:
            self._set_error(said_by(error))
            if wanted == self._wanted:
                self._not_before = asyncio.get_running_loop().time() + self._retry.next()
            return
        self._shown = wanted
        self._scenes_due = -math.inf  # this change of the map may have changed the list of scenes

    def _map_grown(self, body: Body) -> None:
        if self._picture_task is None or self._picture_task.done():  # else the report is skipped
            self._start_picture_task(self._show_grown_map(body))

    async def _show_grown_map(self, body: Body) -> None:
        try:
            report: BuildMapData = body.message()
            origin = report.origin_x, report.origin_y, 0.0
            self._set_picture(await _picture(report.map_data, b"", report.resolution, origin, {}))
        except (FrameError, maps.MapError):  # the next report comes within a second
            return

    def end_subscription(self) -> None:
        """End the subscription to the map that the robot is making; `update` begins it again."""
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None

    def _start_picture_task(self, work: Coroutine[Any, Any, None]) -> None:
        self._picture_task = asyncio.get_running_loop().create_task(work, name="map picture")

    def _set_error(self, error: str) -> None:
        if self.error != error:
            self.error = error
            self._on_change()

    def _set_picture(self, picture: MapPicture) -> None:
        self.picture = picture
        self.number += 1
        self.error = ""
        self._on_change()


async def _picture(
    png: bytes,
    keepout_png: bytes,
    resolution: float,
    origin: tuple[float, float, float],
    content: dict[str, Any],
) -> MapPicture:
    """Return a map, made of the images of a robot and of `content`, further data for the page.

    Raises:
        MapError: the map has no valid resolution, origin or image.
    """
    maps.check_resolution_and_origin(resolution, *origin)
    # decoding a large image would block the link
    map_png = await asyncio.to_thread(maps.grey_png, png)
    keepout, problem = b"", ""
    if keepout_png:
        try:
            keepout = await asyncio.to_thread(maps.grey_png, keepout_png)
        except maps.MapError as error:
            problem = _NO_KEEPOUT(reason=said_by(error))
    pose = dict(zip(("x", "y", "theta"), origin, strict=True))
    data = {"resolution": resolution, "origin": pose, "keepout": bool(keepout), **content}
    return MapPicture(map_png, keepout, problem, data)
