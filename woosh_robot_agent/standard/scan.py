"""scan: the laser, asked while somebody wants to see it."""

from __future__ import annotations

import array
import asyncio
import logging
import math
from typing import Any

from rclpy.duration import Duration
from sensor_msgs.msg import LaserScan

from woosh_robot_agent.link import LinkError, LinkState
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.pb.robot.robot_pb2 import ScannerData
from woosh_robot_agent.standard.audience import Audience
from woosh_robot_agent.standard.odom import transforms
from woosh_robot_agent.standard.part_context import Part, PartContext
from woosh_robot_agent.standard.plane import Plane

_LOG = logging.getLogger(__name__)


class Scan(Part):
    """Publishes scan at `scan_rate` while it has subscribers and the link is ready.

    The chassis gives scans only when asked. Its laser's place, where the firmware tells it, goes
    out on /tf_static with `publish_laser_tf`; for that it is asked once on each new link.
    """

    def __init__(self, host: PartContext) -> None:
        self._host = host
        self._log = LogOnce(_LOG)
        settings = host.settings()
        self._audience = Audience(host)
        self._scan = self._audience.publisher("scan") if settings.enable_scan else None
        place = settings.publish_tf and settings.publish_laser_tf
        self._tf_static = host.publisher("/tf_static") if place else None
        self._place: Plane | None = None
        self._height = 0.0
        self._asking = asyncio.Lock()
        host.chassis.on_state(self._link_changed)

    async def run(self) -> None:
        """See `Part.run`: ask, and publish; never two questions at a time."""
        async for _ in self._audience.times(lambda: self._host.settings().scan_rate):
            if self._host.chassis.state is LinkState.READY:
                await self._ask()

    def _link_changed(self, state: LinkState) -> None:
        if self._tf_static is not None and state is LinkState.READY:
            self._host.thread.spawn(self._ask)

    async def _ask(self) -> None:
        async with self._asking:
            await self._ask_alone()

    async def _ask_alone(self) -> None:
        asked = self._host.node.get_clock().now()
        try:
            answer = await self._host.chassis.request(self._host.requests.empty(ScannerData))
        except LinkError as error:
            self._log.warn("link", f"no scan: {error}")
            return
        if not answer.ok or not isinstance(answer.body, ScannerData):
            self._log.warn("refused", f"no scan: {answer.msg or answer.defect or answer.type}")
            return
        self._log.clear()
        self._place_laser(answer.body)
        if self._scan is not None:
            # it was measured some time between question and answer
            taken = self._host.node.get_clock().now() - asked
            middle = asked + Duration(nanoseconds=taken.nanoseconds // 2)
            self._scan.publish(self._message(answer.body, middle.to_msg()))

    def _message(self, data: ScannerData, stamp: Any) -> LaserScan:
        message = LaserScan(
            angle_min=data.angle_min,
            angle_max=data.angle_max,
            angle_increment=data.angle_increment,
            time_increment=data.time_increment,
            scan_time=data.scan_time,
            range_min=data.range_min,
            range_max=data.range_max,
            ranges=rep_117(data.ranges, data.range_min, data.range_max),
        )
        message.header.stamp = stamp
        message.header.frame_id = self._host.frame("scan")
        return message

    def _place_laser(self, data: ScannerData) -> None:
        if self._tf_static is None or not data.HasField("offset"):
            return
        place, height = Plane(data.offset.x, data.offset.y), data.offset.z
        if (place, height) == (self._place, self._height):
            return
        self._place, self._height = place, height
        frame = self._host.frame
        message = transforms(self._host.now(), (frame("base"), frame("scan"), place))
        message.transforms[0].transform.translation.z = height
        self._tf_static.publish(message)


def rep_117(ranges: Any, least: float, most: float) -> array.array[float]:
    """Ranges in m as REP 117 has them.

    What is beyond `most`, and a 0, with which some lasers say that nothing came back, is +inf; what
    is nearer than `least` is -inf; what is no number stays so.
    """
    far, near = math.inf, -math.inf
    return array.array(
        "f",
        [
            far if r > most or r == 0.0 else near if r < least else r  # NaN passes through all
            for r in ranges
        ],
    )
