"""One robot of the page: its link, its state for all viewers, and its scans as binary messages."""

from __future__ import annotations

import array
import asyncio
import contextlib
import json
import math
import struct
import sys
from collections.abc import Callable, Set
from dataclasses import replace
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.endpoints import TOPICS, minimum_timeouts
from woosh_robot_agent.link import ChassisClient, LinkConfig, LinkError, LinkState
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.motion.requests import only_reads
from woosh_robot_agent.pb.robot.robot_pb2 import RobotState, ScannerData
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.tools.dashboard import part_data
from woosh_robot_agent.tools.dashboard.part_data import MapSource
from woosh_robot_agent.tools.robot_view import RobotView, link_report

_HEADER = struct.Struct("<4x7f")
"""Pose x, y, theta of the robot; offset x, y of the laser; first angle, angle between two rays.

The first four bytes are zero, and the ranges follow: whole millimetres, as 16-bit integers. The
range 0 stands for no reflection. All is little-endian, in metres and radians.
"""
_MAX_RAYS = 10_000
"""Maximum number of rays that are sent."""
_MAX_RANGE = 65.535
"""Greatest range that can be expressed, in metres."""


def scan_frame(scan: ScannerData, pose: tuple[float, float, float]) -> bytes | None:
    """Return the message for a scan; None if the scan has no valid angles or pose.

    Args:
        scan: the scan.
        pose: pose of the robot, used if the scan has none.
    """
    if scan.HasField("pose"):
        pose = scan.pose.x, scan.pose.y, scan.pose.theta
    values = (*pose, scan.offset.x, scan.offset.y, scan.angle_min, scan.angle_increment)
    if not all(map(math.isfinite, values)):
        return None
    low, high = max(0.0, scan.range_min), min(scan.range_max or _MAX_RANGE, _MAX_RANGE)
    # a comparison with NaN is False
    measured = [int(r * 1000.0) if low <= r <= high else 0 for r in scan.ranges[:_MAX_RAYS]]
    ranges = array.array("H", measured)
    if sys.byteorder == "big":
        ranges.byteswap()
    return _HEADER.pack(*values) + ranges.tobytes()


_MAX_BACKOFF = 3.0
"""Longest pause between attempts to connect, in seconds; short, because somebody is watching."""
_UPDATE_PERIOD = 0.1
"""Shortest time between two updates of the viewers, in seconds."""
_SLOW_PERIOD = 1.0
"""Time between two updates of what changes all the time, such as counters, in seconds."""
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

SCAN = "scan"
"""Name of the part that holds the laser scan, which is binary; the others are JSON."""


class Robot:
    """A robot that viewers watch. Used in one asyncio event loop.

    Its state is divided into parts, each a message for the page. A part is sent again when it has
    changed. While nobody watches, no scans and no maps are requested.

    Args:
        config: address and timeouts of the robot.
        control: the robot may be commanded. Otherwise the client of the link refuses every request
            that could change something.
        scan_rate: rate at which scans are requested, in Hz.

    Attributes:
        chassis: the link.
        view: state of the robot as received so far.
        requests: puts the robot's id into requests, if there is one.
        map: the map of the robot.
        silence: whole seconds for which a watched robot has sent nothing although it is connected.
        parts: last message of each part, by its name.
    """

    def __init__(self, config: LinkConfig, *, control: bool, scan_rate: float) -> None:
        self.chassis = ChassisClient(
            config=replace(config, backoff_max=_MAX_BACKOFF), minimum_timeouts=minimum_timeouts()
        )
        if not control:
            self.chassis.permit_only(only_reads, READ_ONLY)
        self.view = RobotView()
        self.requests = RequestMaker(config.robot_id)
        self.map = MapSource(self.chassis, self.changed)
        self.silence = 0
        self._heard_at = 0.0
        """Loop time at which the last frame of the robot was noticed."""
        self.parts: dict[str, str | bytes] = {}
        self._scan_rate = scan_rate
        self._sources: dict[str, Callable[[], Any]] = {
            "pose": lambda: part_data.pose_data(self.view.info),
            "robot": lambda: part_data.robot_data(self.view),
            "outline": lambda: part_data.outline_data(self.view.info),
            "path": lambda: part_data.path_data(self.view),
            "codes": lambda: part_data.codes_data(self.view),
            "map": self._map_data,
        }
        self._slow_sources: dict[str, Callable[[], Any]] = {"link": self._link_data}
        self._watchers: dict[object, Callable[[Set[str]], None]] = {}
        """Callbacks of the viewers."""
        self._changed = asyncio.Event()
        self._watched = asyncio.Event()
        """Set while somebody watches."""
        self._tasks: list[asyncio.Task[None]] = []
        self.chassis.on_state(lambda state: self.changed())
        self.chassis.on_snapshot(self._received)
        for topic in TOPICS:
            if not topic.on_demand:
                self.chassis.subscribe(message_type(topic.push), self._received)
        self.chassis.subscribe(Feedbacks, self._received)

    def start(self) -> None:
        """Start connecting."""
        self.chassis.start()
        loop = asyncio.get_running_loop()
        for work in (self._update(), self._update_slowly(), self._scan(), self._listen()):
            self._tasks.append(loop.create_task(work, name="dashboard"))

    async def close(self) -> None:
        """Close the link."""
        self.map.close()
        for task in self._tasks:
            task.cancel()
        await self.chassis.close()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def add_part(self, name: str, source: Callable[[], Any]) -> None:
        """Add a part.

        Args:
            name: name of the part.
            source: returns the data of the part.
        """
        self._sources[name] = source
        self.changed()

    def add_slow_part(self, name: str, source: Callable[[], Any]) -> None:
        """Add a part that also changes without a call of `changed`; see `add_part`."""
        self._slow_sources[name] = source
        self.add_part(name, source)

    def changed(self) -> None:
        """Send the parts that have changed, within `_UPDATE_PERIOD`."""
        self._changed.set()

    def watch(self, viewer: object, callback: Callable[[Set[str]], None]) -> None:
        """Call `callback` with the names of parts that have changed, at first with all of them."""
        if not self._watchers:
            self._heard_at = asyncio.get_running_loop().time()
        self._watchers[viewer] = callback
        self._watched.set()
        self.changed()
        callback(self.parts.keys() - {SCAN})

    def unwatch(self, viewer: object) -> None:
        """End what `watch` began; idempotent."""
        self._watchers.pop(viewer, None)
        if not self._watchers:
            self._watched.clear()
            self.silence = 0

    @property
    def watched(self) -> bool:
        """True while somebody watches."""
        return self._watched.is_set()

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
        self.changed()

    async def _update(self) -> None:
        while True:
            await self._watched.wait()
            await self._changed.wait()
            self._changed.clear()
            self._publish(self._sources)
            await asyncio.sleep(_UPDATE_PERIOD)

    async def _update_slowly(self) -> None:
        while True:
            await self._watched.wait()
            info = self.view.info
            self.map.update(info.scene, info.state == robot.kMapping)
            self._publish(self._slow_sources)
            await asyncio.sleep(_SLOW_PERIOD)

    def _publish(self, sources: dict[str, Callable[[], Any]]) -> None:
        """Make the messages of parts, and tell the viewers which ones have changed."""
        changed = set()
        for name, source in sources.items():
            message = json.dumps({"part": name, "data": source()}, separators=(",", ":"))
            if self.parts.get(name) != message:
                self.parts[name] = message
                changed.add(name)
        self._tell(changed)

    def _tell(self, names: Set[str]) -> None:
        if names:
            for callback in list(self._watchers.values()):
                callback(names)

    async def _scan(self) -> None:
        loop = asyncio.get_running_loop()
        due = -math.inf
        while True:
            await self._watched.wait()
            due = max(due + 1.0 / self._scan_rate, loop.time())
            await asyncio.sleep(due - loop.time())
            if self.chassis.state is LinkState.READY:
                await self._request_scan()

    async def _listen(self) -> None:
        """Measure the silence of the robot, and tell the viewers of each second of it."""
        loop = asyncio.get_running_loop()
        received, asking = 0, None
        while True:
            await self._watched.wait()
            due = loop.time() + _LISTEN_PERIOD
            await asyncio.sleep(_LISTEN_PERIOD)
            now = loop.time()
            if now - due > _BUSY:
                self._heard_at += now - due
            if self.chassis.state is not LinkState.READY or self.chassis.stats.rx != received:
                self._heard_at = now
            received = self.chassis.stats.rx
            silence = now - self._heard_at
            if silence > _PROBE_AFTER and (asking is None or asking.done()):
                asking = loop.create_task(self._ask(), name="dashboard probe")
            if int(silence) != self.silence:
                self.silence = int(silence)
                self._publish({"link": self._link_data})

    async def _ask(self) -> None:
        """Request something small."""
        with contextlib.suppress(LinkError):  # the page shows the silence
            answer = await self.chassis.request(self.requests.empty(RobotState))
            if answer.ok and isinstance(answer.body, RobotState):
                self._received(answer.body)

    async def _request_scan(self) -> None:
        try:
            answer = await self.chassis.request(self.requests.empty(ScannerData))
        except LinkError:  # the page shows the state of the link
            return
        if not answer.ok or not isinstance(answer.body, ScannerData):
            return
        pose = self.view.info.pose_speed.pose
        frame = scan_frame(answer.body, (pose.x, pose.y, pose.theta))
        if frame is not None and frame != self.parts.get(SCAN):
            self.parts[SCAN] = frame
            self._tell({SCAN})

    def _link_data(self) -> dict[str, Any]:
        report = link_report(self.chassis)
        if report.good and self.no_data:
            detail = "connected, but the robot sends nothing: its program or the network may hang"
            return {"good": False, "text": self.no_data, "detail": detail}
        return {"good": report.good, "text": report.text, "detail": report.detail}

    def _map_data(self) -> dict[str, Any]:
        if self.map.picture is None:
            return {"number": self.map.number, "error": self.map.error}
        return {"number": self.map.number, "error": self.map.error, **self.map.picture.data}
