"""The topics map and keepout_mask: the chassis's map, and the robot's keep-out areas, as grids.

While the robot is making a map, that map is published.
"""

from __future__ import annotations

import array
import asyncio
import logging
import math
from collections.abc import Callable
from typing import NamedTuple

from nav_msgs.msg import OccupancyGrid

from woosh_robot_agent.link import (
    Body,
    ChassisClient,
    ConnectionLostError,
    FrameError,
    LinkError,
    LinkState,
    RequestTimeoutError,
)
from woosh_robot_agent.link.reconnect import Backoff
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pack_pb2 import BuildMapData
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, RobotState, Scene
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.robot.maps import (
    MapError,
    cells_of,
    check_resolution_and_origin,
    find_map,
    scene_data,
)
from woosh_robot_agent.ros.standard.part import Part, PartContext
from woosh_robot_agent.ros.standard.poses import Pose2D, to_pose
from woosh_robot_agent.ros.subscribers import Subscribers

_MAX_SILENCE = 3.0
"""Time without a report of a map after which a robot in one of `_VAGUE_STATES` makes no map, in
seconds. A robot that makes a map reports it each second."""
_VAGUE_STATES = (robot.kStateUndefined, robot.kWarning, robot.kFault)
"""States that do not tell if the robot is making a map; its reports of the map do."""


class GrowingMap:
    """The map that the robot is making, from its reports while there are subscribers.

    Use it in the link thread.

    Args:
        on_end: called when the robot no longer makes a map.
    """

    def __init__(
        self, chassis: ChassisClient, subscribers: Subscribers, on_end: Callable[[], None]
    ) -> None:
        self._chassis = chassis
        self._subscribers = subscribers
        self._on_end = on_end
        self._unsubscribe: Callable[[], None] | None = None
        """Ends the subscription to the reports; None if there is none."""
        self._state = robot.kStateUndefined
        """The last reported state of the robot."""
        self._was_active = False
        """True from the first sign of a map that is being made until `on_end` is called."""
        self._body: Body | None = None
        """The latest report, not decoded yet; None once it is taken or outdated."""
        self._received = -math.inf
        """Loop time of the latest report; -inf while the robot makes no map."""
        chassis.on_snapshot(self._snapshot)
        chassis.subscribe(RobotState, lambda push: self._set_state(push.state))

    @property
    def active(self) -> bool:
        """True while the robot is making a map."""
        if self._state == robot.kMapping:
            return True
        return asyncio.get_running_loop().time() - self._received < _MAX_SILENCE

    def subscribe(self) -> None:
        """Receive reports until there are no subscribers; idempotent."""
        if self._unsubscribe is None:
            self._unsubscribe = self._chassis.subscribe_raw(BuildMapData, self._pushed)

    def take(self) -> BuildMapData | None:
        """Remove the latest report and return it; None if there is none, or it cannot be read."""
        body, self._body = self._body, None
        try:
            return None if body is None else body.message()
        except FrameError:  # the link has logged it
            return None

    def _snapshot(self, info: RobotInfo) -> None:
        self._body = None  # a report from before the link was lost is outdated
        self._set_state(info.state)

    def _set_state(self, state: robot.State) -> None:
        """Note the robot's state. A state that is neither mapping nor vague ends the map."""
        self._state = state
        if state == robot.kMapping:
            self._was_active = True
        elif state not in _VAGUE_STATES:
            self._body = None
            self._received = -math.inf
            if self._was_active:
                self._was_active = False
                self._on_end()

    def _pushed(self, body: Body) -> None:
        """Keep a report of the map; without subscribers, end the subscription to the reports."""
        if not self._subscribers.present:
            if self._unsubscribe is not None:
                self._unsubscribe()
                self._unsubscribe = None
        elif self._state == robot.kMapping or self._state in _VAGUE_STATES:
            self._was_active = True
            self._body = body
            self._received = asyncio.get_running_loop().time()


_LOG = logging.getLogger(__name__)
_CHECK_RATE = 2.0
"""Rate of checking if a map has to be requested or published, in Hz."""
_RETRY_DELAY = 10.0
"""Delay before a failed request is retried, in seconds. It doubles each time if no answer came:
a map may be too large for the link, or exceed `max_frame_size`, which closes the link."""
_MAX_RETRY_DELAY = 300.0
"""Longest such delay, in seconds."""
_FORBIDDEN = 100
"""Value of a cell in a keep-out area."""


class MapVersion(NamedTuple):
    """A version of a map in a scene."""

    scene: str
    map_id: int
    name: str
    version: int


class Map(Part):
    """Publishes map and keepout_mask on demand, after a lost link, and when the map changes.

    A map can have many MiB, so it is requested only for a subscriber. Failed requests are retried.
    While the robot is making a map, this growing map is published instead, whenever it is reported.
    """

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._log = LogOnce(_LOG)
        self._subscribers = context.subscribers()
        self._publisher = context.publisher("map", self._subscribers)
        self._keepout_publisher = context.publisher("keepout_mask", self._subscribers)
        self._used: MapVersion | None = None
        """The map that the robot uses; None if unknown."""
        self._published: MapVersion | None = None
        """The scene's map that was published last; None if it has to be published again."""
        self._retry = Backoff(_RETRY_DELAY, _MAX_RETRY_DELAY)
        """Delays after requests without an answer."""
        self._loses_link = False
        """True if the link was lost during the last request."""
        self._not_before = -math.inf
        """Loop time before which the map is not requested again."""
        self._finished_maps = 0
        """Number of maps that the robot has finished; a map requested before is dropped."""
        self._shows_growing = False
        """True if the last message was a map that the robot was making."""
        self._growing = GrowingMap(context.chassis, self._subscribers, self._map_finished)
        context.chassis.on_snapshot(self._snapshot)
        context.chassis.subscribe(Scene, self._scene_reported)

    async def run(self) -> None:
        await self._subscribers.repeat(lambda: _CHECK_RATE, self._check)

    async def _check(self, now: float) -> None:
        """Request or publish the map if needed."""
        self._growing.subscribe()
        if self._context.chassis.state is not LinkState.READY:
            return
        if self._growing.active:
            await self._publish_growing()
        elif self._used != self._published and now >= self._not_before:
            await self._update()

    def _snapshot(self, info: RobotInfo) -> None:
        """Process the first RobotInfo of a link."""
        # problems are logged once for each link, even if good and bad maps alternate
        self._log.clear()
        if info.HasField("scene"):
            self._scene_reported(info.scene)
        if not self._loses_link:  # otherwise an early request could lose the link again
            self._published = None  # the robot may have made a new map with the same version
            self._request_soon()

    def _scene_reported(self, scene: Scene) -> None:
        used = MapVersion(scene.scene_name, scene.map_id, scene.map_name, scene.version)
        if used != self._used:
            self._used = used
            self._request_soon()

    def _request_soon(self) -> None:
        """Request the scene's map at the next check."""
        self._retry.reset()
        self._not_before = -math.inf

    def _map_finished(self) -> None:
        """Request the scene's map again: a new map can replace one with the same version."""
        self._published = None
        self._finished_maps += 1
        self._request_soon()
        if self._shows_growing:
            self._context.thread.spawn(self._replace_growing)

    async def _replace_growing(self) -> None:
        """Publish the scene's map also without subscribers.

        A later subscriber must not get the unfinished map, which is latched.
        """
        clock = asyncio.get_running_loop().time
        while self._shows_growing and not self._growing.active:
            if not self._subscribers.present:  # else it is left to `_check`
                await self._check(clock())
            await asyncio.sleep(1.0 / _CHECK_RATE)

    async def _publish_growing(self) -> None:
        """Publish the last report of the map that the robot is making, if there is a new one."""
        finished, report = self._finished_maps, self._growing.take()
        if report is None:
            return
        origin = Pose2D(report.origin_x, report.origin_y)
        try:
            message = await grid(self._context, report.map_data, report.resolution, origin)
        except ValueError as error:
            self._context.chassis.count_bad_value(
                BuildMapData, f"no map while the robot is making one, {error}"
            )
            return
        if finished != self._finished_maps or not self._growing.active:  # it was finished meanwhile
            return
        self._publisher.publish(message)
        self._published = None
        self._shows_growing = True

    async def _update(self) -> None:
        """Request the map that the robot uses, and publish it with its mask."""
        used, finished = self._used, self._finished_maps
        if used is None:
            return
        clock = asyncio.get_running_loop().time
        self._not_before = clock() + _RETRY_DELAY
        self._loses_link = False
        try:
            scene = await scene_data(self._context.chassis, used.scene)
            area = find_map(scene, used.map_id, used.name)
        except (LinkError, MapError) as error:
            if isinstance(error, ConnectionLostError | RequestTimeoutError):
                self._not_before = clock() + self._retry.next()
            self._loses_link = isinstance(error, ConnectionLostError)
            self._log.warn(str(error), f"no map: {error}")
            return
        try:
            origin = Pose2D.from_message(area.origin)
            message = await grid(self._context, area.map_png, area.resolution, origin)
        except ValueError as error:
            self._context.chassis.count_bad_value(SceneData, f"no map, {error}")
            return
        mask = await self._keepout_mask(area, message)
        is_outdated = finished != self._finished_maps or used != self._used
        if is_outdated or self._growing.active:
            return
        self._retry.reset()
        self._publisher.publish(message)
        self._keepout_publisher.publish(mask)
        self._published = used
        self._shows_growing = False

    async def _keepout_mask(self, area: SceneData.Map, published: OccupancyGrid) -> OccupancyGrid:
        """Return the mask that belongs to a published map; it forbids all if it cannot be read."""
        if not area.keepout_png:  # a map without keep-out areas
            return _uniform_mask(published, 0)
        try:
            origin = Pose2D.from_message(area.origin)
            mask = await grid(self._context, area.keepout_png, area.resolution, origin)
        except ValueError as error:
            self._context.chassis.count_bad_value(
                SceneData,
                "keepout_mask forbids the whole map until its keep-out areas are saved again, "
                f"{error}",
            )
            return _uniform_mask(published, _FORBIDDEN)
        mask.header, mask.info.map_load_time = published.header, published.info.map_load_time
        return mask


def _uniform_mask(area: OccupancyGrid, cell: int) -> OccupancyGrid:
    """Return a mask for a map with the same value in each cell."""
    cells = array.array("b", bytes((cell,)) * len(area.data))
    return OccupancyGrid(header=area.header, info=area.info, data=cells)


async def grid(
    context: PartContext, image: bytes, resolution: float, origin: Pose2D
) -> OccupancyGrid:
    """Return a map as OccupancyGrid.

    Args:
        image: the map as PNG.
        resolution: size of a cell, in metres.
        origin: pose of the lower left corner of the image in the map's frame.

    Raises:
        ValueError: the map has no valid resolution, origin or image.
    """
    check_resolution_and_origin(resolution, origin.x, origin.y)
    # in another thread, because decoding a large image would block the link
    width, height, cells = await asyncio.to_thread(cells_of, image)
    message = OccupancyGrid(header=context.header("map"), data=cells)
    message.info.map_load_time = message.header.stamp
    message.info.resolution = resolution
    message.info.width, message.info.height = width, height
    message.info.origin = to_pose(origin)
    return message
