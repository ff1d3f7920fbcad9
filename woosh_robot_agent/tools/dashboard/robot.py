"""One robot of the page: its link, its map, and the store of what its viewers see."""

from __future__ import annotations

import asyncio
import json
import logging
import math
from collections.abc import Callable, Set
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.endpoints import minimum_timeouts
from woosh_robot_agent.link import (
    Body,
    ChassisClient,
    FrameError,
    LinkConfig,
    LinkError,
    LinkState,
)
from woosh_robot_agent.motion.requests import only_reads
from woosh_robot_agent.pb.robot.robot_pack_pb2 import BuildMapData
from woosh_robot_agent.pb.robot.robot_pb2 import RobotState, ScannerData, Scene
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.robot.maps import MapError, check_place, grey_png, scene_map
from woosh_robot_agent.tools.dashboard import part_data
from woosh_robot_agent.tools.robot_view import (
    MAX_BACKOFF,
    RobotView,
    link_report,
    subscribe_all,
)

_LOG = logging.getLogger(__name__)
M = TypeVar("M", bound=Message)
SCAN = "scan"
"""Name of the part that holds the laser scan, which is binary; the others are JSON."""


class Parts:
    """Store of what viewers see of a robot: a message for each part, sent again when it changes.

    Attributes:
        messages: last message of each part, by its name: JSON as text, or binary.
    """

    def __init__(self) -> None:
        self.messages: dict[str, str | bytes] = {}
        self._sources: dict[str, Callable[[], Any]] = {}
        """Functions that return the data of the parts, by name."""
        self._on_change: list[str] = []
        self._each_second: list[str] = []
        self._viewers: dict[object, Callable[[Set[str]], None]] = {}
        """Callbacks of the viewers."""
        self._changed = asyncio.Event()
        self._watched = asyncio.Event()
        """Set while somebody watches."""

    def add(
        self,
        name: str,
        source: Callable[[], Any],
        *,
        on_change: bool = True,
        each_second: bool = False,
    ) -> None:
        """Add a part.

        Args:
            name: name of the part.
            source: returns the data of the part.
            on_change: make it anew soon after each call of `changed`.
            each_second: make it anew once a second, because it changes without such a call.
        """
        self._sources[name] = source
        if on_change:
            self._on_change.append(name)
        if each_second:
            self._each_second.append(name)

    def changed(self) -> None:
        """Tell that the data of parts may have changed."""
        self._changed.set()

    def put(self, name: str, message: bytes) -> None:
        """Set the message of a binary part."""
        if self.messages.get(name) != message:
            self.messages[name] = message
            self._tell({name})

    def publish(self, *names: str) -> None:
        """Make the messages of parts, and tell the viewers which ones have changed."""
        changed = set()
        for name in names:
            content = {"part": name, "data": self._sources[name]()}
            message = json.dumps(content, separators=(",", ":"))
            if self.messages.get(name) != message:
                self.messages[name] = message
                changed.add(name)
        self._tell(changed)

    async def publish_changes(self, period: float) -> None:
        """Publish parts whenever they may have changed, while somebody watches.

        Args:
            period: shortest time between two times, in seconds.
        """
        while True:
            await self._watched.wait()
            await self._changed.wait()
            self._changed.clear()
            self.publish(*self._on_change)
            await asyncio.sleep(period)

    async def publish_each_second(self) -> None:
        """Publish the parts that change without a call of `changed`, while somebody watches."""
        while True:
            await self._watched.wait()
            self.publish(*self._each_second)
            await asyncio.sleep(1.0)

    def watch(self, viewer: object, callback: Callable[[Set[str]], None]) -> None:
        """Call `callback` with the names of parts that have changed, at first with all of them."""
        self._viewers[viewer] = callback
        self._watched.set()
        self.changed()
        callback(self.messages.keys() - {SCAN})

    def unwatch(self, viewer: object) -> None:
        """End what `watch` began; idempotent."""
        self._viewers.pop(viewer, None)
        if not self._viewers:
            self._watched.clear()

    @property
    def watched(self) -> bool:
        """True while somebody watches."""
        return self._watched.is_set()

    async def wait_watched(self) -> None:
        """Wait until somebody watches."""
        await self._watched.wait()

    def _tell(self, names: Set[str]) -> None:
        if names:
            for callback in list(self._viewers.values()):
                callback(names)


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

    def data(self) -> dict[str, Any]:
        """Return the part of the map for the page."""
        place = {} if self.picture is None else self.picture.data
        return {"number": self.number, "error": self.error, **place}

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
            origin = area.origin.x, area.origin.y, area.origin.theta
            marks = part_data.marks_data(area)
            self._set(await _picture(area.map_png, area.resolution, origin, marks))
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
            origin = report.origin_x, report.origin_y, 0.0
            self._set(await _picture(report.map_data, report.resolution, origin, []))
        except (FrameError, MapError):  # the next one comes within a second
            return

    def _end_growing(self) -> None:
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None

    def _start(self, work: Any) -> None:
        self._task = asyncio.get_running_loop().create_task(work, name="map picture")

    def _set(self, picture: MapPicture) -> None:
        self.picture = picture
        self.number += 1
        self.error = ""
        self._on_change()


async def _picture(
    png: bytes, resolution: float, origin: tuple[float, float, float], marks: list[Any]
) -> MapPicture:
    """Return the picture of a map.

    Raises:
        MapError: the map has no valid resolution, origin or image.
    """
    check_place(resolution, *origin)
    # decoding a large image would block the link
    data = await asyncio.to_thread(grey_png, png)
    place = dict(zip(("x", "y", "theta"), origin, strict=True))
    return MapPicture(data, {"resolution": resolution, "origin": place, "marks": marks})


_MAP_PERIOD = 1.0
"""Time between two looks whether the robot uses another map, in seconds."""
_LISTEN_PERIOD = 0.1
"""Time between two looks whether the robot has sent something, in seconds."""
_PROBE_AFTER = 0.5
"""Silence after which the robot is asked for something, in seconds.

A standing robot pushes nothing, and scans may be rare.
"""
_BUSY = 0.3
"""Delay of a look from which this program was busy, in seconds; that is no silence of the robot."""
READ_ONLY = "the dashboard only shows: start it with --control to command the robot"
"""Reason for which commands are refused."""


class Robot:
    """A robot that viewers watch. Used in one asyncio event loop.

    While nobody watches, no scans and no maps are requested.

    Args:
        config: address and timeouts of the robot.
        control: the robot may be commanded. Otherwise the client of the link refuses every request
            that could change something.
        scan_rate: rate at which scans are requested, in Hz.
        update_period: shortest time between two updates of the viewers, in seconds.

    Attributes:
        chassis: the link.
        view: state of the robot as received so far.
        requests: puts the robot's id into requests, if there is one.
        map: the map of the robot.
        parts: what viewers see of the robot.
        silence: whole seconds for which a watched robot has sent nothing although it is connected.
    """

    def __init__(
        self, config: LinkConfig, *, control: bool, scan_rate: float, update_period: float = 0.1
    ) -> None:
        self.chassis = ChassisClient(
            config=replace(config, backoff_max=MAX_BACKOFF), minimum_timeouts=minimum_timeouts()
        )
        if not control:
            self.chassis.permit_only(only_reads, READ_ONLY)
        self.view = RobotView()
        self.requests = RequestMaker(config.robot_id)
        self.parts = Parts()
        self.map = MapSource(self.chassis, self.parts.changed)
        self.silence = 0
        self._scan_rate = scan_rate
        self._update_period = update_period
        for name, source in (
            ("pose", lambda: part_data.pose_data(self.view.info)),
            ("robot", lambda: part_data.robot_data(self.view)),
            ("outline", lambda: part_data.outline_data(self.view.info)),
            ("path", lambda: part_data.path_data(self.view)),
            ("codes", lambda: part_data.codes_data(self.view)),
            ("map", self.map.data),
        ):
            self.parts.add(name, source)
        self.parts.add("link", self._link_data, on_change=False, each_second=True)
        self._running: asyncio.Task[None] | None = None
        self.chassis.on_state(lambda state: self.parts.changed())
        subscribe_all(self.chassis, self._received)

    def start(self) -> None:
        """Start connecting."""
        self.chassis.start()
        self._running = asyncio.get_running_loop().create_task(self._run(), name="dashboard")

    async def close(self) -> None:
        """Close the link."""
        self.map.close()
        if self._running is not None:
            self._running.cancel()
            await asyncio.wait({self._running})
        await self.chassis.close()

    @property
    def summary(self) -> str:
        """Address, name and state in one line."""
        trouble = self.no_data if self.chassis.state is LinkState.READY else "no connection"
        return part_data.summary(self.view, self.chassis.config.address, trouble)

    @property
    def no_data(self) -> str:
        """For how long the robot has sent nothing; empty if it does. Measured while watched."""
        return f"no data for {self.silence} s" if self.silence else ""

    def _received(self, message: Message) -> None:
        self.view.update(message)
        self.parts.changed()

    async def _run(self) -> None:
        try:
            await asyncio.gather(
                self.parts.publish_changes(self._update_period),
                self.parts.publish_each_second(),
                self._update_map(),
                self._scan(),
                self._listen(),
            )
        except Exception:
            _LOG.exception("the page no longer shows %s", self.chassis.config.address)

    async def _update_map(self) -> None:
        while True:
            await self.parts.wait_watched()
            info = self.view.info
            self.map.update(info.scene, info.state == robot.kMapping)
            await asyncio.sleep(_MAP_PERIOD)

    async def _scan(self) -> None:
        loop = asyncio.get_running_loop()
        due = -math.inf
        while True:
            await self.parts.wait_watched()
            due = max(due + 1.0 / self._scan_rate, loop.time())
            await asyncio.sleep(due - loop.time())
            scan = await self._request(ScannerData)
            if scan is not None:
                pose = self.view.info.pose_speed.pose
                frame = part_data.scan_frame(scan, (pose.x, pose.y, pose.theta))
                if frame is not None:
                    self.parts.put(SCAN, frame)

    async def _listen(self) -> None:
        """Measure the silence of the robot, and tell the viewers of each second of it."""
        loop = asyncio.get_running_loop()
        received, heard_at = 0, loop.time()
        asking: asyncio.Task[None] | None = None
        while True:
            if not self.parts.watched:
                self.silence = 0
                await self.parts.wait_watched()
                heard_at = loop.time()
            due = loop.time() + _LISTEN_PERIOD
            await asyncio.sleep(_LISTEN_PERIOD)
            now = loop.time()
            if now - due > _BUSY:
                heard_at += now - due
            if self.chassis.state is not LinkState.READY or self.chassis.stats.rx != received:
                heard_at = now
            received = self.chassis.stats.rx
            silence = now - heard_at
            if silence > _PROBE_AFTER and (asking is None or asking.done()):
                asking = loop.create_task(self._ask(), name="dashboard probe")
            if int(silence) != self.silence:
                self.silence = int(silence)
                self.parts.publish("link")

    async def _ask(self) -> None:
        """Request something small."""
        state = await self._request(RobotState)
        if state is not None:
            self._received(state)

    async def _request(self, cls: type[M]) -> M | None:
        """Request a value; return None if there is none, because the page shows why."""
        if self.chassis.state is not LinkState.READY:
            return None
        try:
            answer = await self.chassis.request(self.requests.empty(cls))
        except LinkError:
            return None
        return answer.body if answer.ok and isinstance(answer.body, cls) else None

    def _link_data(self) -> dict[str, Any]:
        report = link_report(self.chassis)
        if report.good and self.no_data:
            detail = "connected, but the robot sends nothing: its program or the network may hang"
            return {"good": False, "text": self.no_data, "detail": detail}
        return {"good": report.good, "text": report.text, "detail": report.detail}
