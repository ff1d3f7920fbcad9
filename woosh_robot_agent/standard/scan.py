"""scan: the laser scan, requested from the chassis on demand."""

from __future__ import annotations

import array
import asyncio
import logging
from typing import Any

import numpy as np
from rclpy.duration import Duration
from sensor_msgs.msg import LaserScan

from woosh_robot_agent.link import LinkError, LinkState
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.pb.robot.robot_pb2 import ScannerData
from woosh_robot_agent.standard.odom import transforms
from woosh_robot_agent.standard.part import Part
from woosh_robot_agent.standard.part_context import PartContext
from woosh_robot_agent.standard.pose2d import Pose2D
from woosh_robot_agent.standard.subscribers import Subscribers

_LOG = logging.getLogger(__name__)


class Scan(Part):
    """Publishes scan at `scan_rate` while it has subscribers and the link is ready.

    The chassis sends scans only on request. With `publish_laser_tf`, one scan is requested on each
    new link. If that scan has the pose of the laser, the pose is published on /tf_static.
    """

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._log = LogOnce(_LOG)
        settings = context.settings()
        self._subscribers = Subscribers(context)
        self._scan = self._subscribers.publisher("scan") if settings.enable_scan else None
        with_tf = settings.publish_tf and settings.publish_laser_tf
        self._tf_static = context.publisher("/tf_static") if with_tf else None
        self._laser_pose: Pose2D | None = None
        self._laser_height = 0.0
        self._requesting = asyncio.Lock()
        """Held during a request: there is never more than one in flight."""
        context.robot.chassis.on_robot_changed(self._forget)
        context.robot.chassis.on_state(self._link_changed)

    async def run(self) -> None:
        async for _ in self._subscribers.times(lambda: self._context.settings().scan_rate):
            if self._context.robot.chassis.state is LinkState.READY:
                await self._request()

    def _forget(self) -> None:
        self._laser_pose = None
        self._log.clear()

    def _link_changed(self, state: LinkState) -> None:
        if self._tf_static is not None and state is LinkState.READY:
            self._context.robot.thread.spawn(self._request)

    async def _request(self) -> None:
        async with self._requesting:
            await self._request_locked()

    async def _request_locked(self) -> None:
        sent = self._context.robot.node.get_clock().now()
        try:
            answer = await self._context.robot.chassis.request(
                self._context.robot.requests.empty(ScannerData)
            )
        except LinkError as error:
            self._log.warn("link", f"no scan: {error}")
            return
        if not answer.ok or not isinstance(answer.body, ScannerData):
            self._log.warn("refused", f"no scan: {answer.msg or answer.defect or answer.type}")
            return
        self._log.clear()
        self._publish_laser_pose(answer.body)
        if self._scan is not None:
            # the time of measurement lies between request and answer
            taken = self._context.robot.node.get_clock().now() - sent
            middle = sent + Duration(nanoseconds=taken.nanoseconds // 2)
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
        message.header.frame_id = self._context.frame("scan")
        return message

    def _publish_laser_pose(self, data: ScannerData) -> None:
        if self._tf_static is None or not data.HasField("offset"):
            return
        pose, height = Pose2D(data.offset.x, data.offset.y), data.offset.z
        if (pose, height) == (self._laser_pose, self._laser_height):
            return
        self._laser_pose, self._laser_height = pose, height
        frame = self._context.frame
        message = transforms(self._context.now(), (frame("base"), frame("scan"), pose))
        message.transforms[0].transform.translation.z = height
        self._tf_static.publish(message)


def rep_117(ranges: Any, least: float, most: float) -> array.array[float]:
    """Return ranges in metres as REP 117 requires them.

    A range above `most` is +inf, and so is 0, which some lasers report if nothing reflects. A range
    below `least` is -inf. NaN stays NaN.
    """
    found = np.array(ranges, dtype=np.float32)
    far = (found > most) | (found == 0.0)  # NaN fails all comparisons
    near = (found < least) & ~far
    found[far], found[near] = np.inf, -np.inf
    return array.array("f", found.tobytes())
