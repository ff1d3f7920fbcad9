"""The topic scan: the laser scan, requested from the chassis on demand."""

from __future__ import annotations

import array
import asyncio
import logging
from typing import Any

import numpy as np
from sensor_msgs.msg import LaserScan

from woosh_robot_agent.convert import converter
from woosh_robot_agent.link import FrameError, LinkError, LinkState
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.pb.robot.robot_pb2 import ScannerData as ScannerDataProto
from woosh_robot_agent.ros.standard.odom import transforms
from woosh_robot_agent.ros.standard.part import Part, PartContext
from woosh_robot_agent.ros.standard.poses import Pose2D, check_finite
from woosh_robot_msgs.msg import ScannerData

_LOG = logging.getLogger(__name__)
_TYPE = full_name(ScannerDataProto)
_CONVERTER = converter(ScannerData, ScannerDataProto)
_SECOND = 1_000_000_000
"""A second, in nanoseconds."""
_TIMEOUT = 1.0
"""Timeout of a request for a scan, in seconds. It replaces the parameter `poll_timeout`, by default
10 s: after a lost answer, no scan would be requested for that time."""

_RETRY_DELAY = 5.0
"""Delay before the laser's pose is requested again, in seconds."""


class Scan(Part):
    """Publishes scan at `scan_rate` while it has subscribers and the link is ready.

    The chassis sends scans only on request. With `publish_laser_tf`, scans are requested on each
    new link until one comes. If it has the pose of the laser, the pose is published on /tf_static.
    """

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._reused = LaserScan()
        """The message for all scans: creating a new message takes as long as filling it."""
        self._log = LogOnce(_LOG)
        settings = context.settings()
        self._subscribers = context.subscribers()
        self._scan = (
            context.publisher("scan", self._subscribers) if settings.enables("scan") else None
        )
        with_tf = settings.publish_tf and settings.publish_laser_tf
        self._tf_static = context.publisher("/tf_static") if with_tf else None
        self._laser: tuple[Pose2D, float] | None = None
        """Pose of the laser on /tf_static, and its height; None before it was published."""
        self._requests_pose = False
        """True while `_request_pose` runs."""
        context.chassis.on_state(self._link_changed)

    async def run(self) -> None:
        await self._subscribers.repeat(
            lambda: self._context.settings().scan_rate, self._request_if_ready
        )

    async def _request_if_ready(self, _now: float) -> None:
        if self._context.chassis.state is LinkState.READY:
            await self._request()

    def _link_changed(self, state: LinkState) -> None:
        if self._tf_static is not None and state is LinkState.READY:
            self._context.thread.spawn(self._request_pose)

    async def _request_pose(self) -> None:
        """Request scans until one has been read, whose pose of the laser is then published."""
        if self._requests_pose:  # it goes on since an earlier link
            return
        self._requests_pose = True
        chassis = self._context.chassis
        try:
            while chassis.state is LinkState.READY and not await self._request():
                await asyncio.sleep(_RETRY_DELAY)
        finally:
            self._requests_pose = False

    async def _request(self) -> bool:
        """Request a scan; publish it and the laser's pose, as far as the parameters enable them.

        Returns:
            True if the chassis has sent a valid scan.
        """
        loop = asyncio.get_running_loop()
        sent = loop.time()
        try:
            answer = await self._context.chassis.request(
                self._context.requests.empty(ScannerDataProto), _TIMEOUT
            )
        except LinkError as error:
            self._log.warn("link", f"no scan: {error}")
            return False
        if not answer.ok or answer.type != _TYPE:
            self._log.warn("refused", f"no scan: {answer.reason or answer.type}")
            return False
        try:
            if self._tf_static is not None:
                self._publish_laser_pose(self._tf_static, answer.raw.message())
            if self._scan is not None:
                # the scan was measured between request and answer; take the middle
                age = int((loop.time() - sent) / 2 * _SECOND)
                stamp = max(self._context.now_ns() - age, 0)  # simulated time begins at 0
                self._scan.publish(self._fill_message(_CONVERTER.read(answer.raw), stamp))
        except FrameError:  # the link has counted and logged it
            return False
        except ValueError as error:
            self._context.chassis.count_bad_value(ScannerDataProto, f"no scan, {error}")
            return False
        self._log.clear()
        return True

    def _fill_message(self, data: ScannerData, stamp: int) -> LaserScan:
        """Set the values of a scan in `_reused`, and return it.

        Args:
            stamp: time of the scan, in nanoseconds.

        Raises:
            ValueError: a number other than a range is not finite, or no range is possible.
        """
        check_finite("angle", data.angle_min, data.angle_max, data.angle_increment)
        check_finite("time", data.time_increment, data.scan_time)
        check_finite("limit of ranges", data.range_min, data.range_max)
        # with such limits, all ranges would become +inf, which stands for free space
        if len(data.ranges) and data.range_max <= data.range_min:
            raise ValueError(
                f"range_max is not above range_min: {data.range_max:g} and {data.range_min:g}"
            )
        message = self._reused
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, _SECOND)
        message.header.frame_id = self._context.frame("scan")
        message.angle_min = data.angle_min
        message.angle_max = data.angle_max
        message.angle_increment = data.angle_increment
        message.time_increment = data.time_increment
        message.scan_time = data.scan_time
        message.range_min = data.range_min
        message.range_max = data.range_max
        message.ranges = apply_rep_117(data.ranges, data.range_min, data.range_max)
        return message

    def _publish_laser_pose(self, tf_static: Any, data: ScannerDataProto) -> None:
        """Publish the laser's pose in a scan, unless it is missing, or has been published."""
        if not data.HasField("offset"):
            return
        try:
            check_finite("offset", data.offset.x, data.offset.y, data.offset.z)
        except ValueError as error:
            self._context.chassis.count_bad_value(ScannerDataProto, str(error))
            return
        pose, height = Pose2D(data.offset.x, data.offset.y), data.offset.z
        if (pose, height) == self._laser:
            return
        self._laser = pose, height
        frame = self._context.frame
        message = transforms(self._context.now(), (frame("base"), frame("scan"), pose))
        message.transforms[0].transform.translation.z = height
        tf_static.publish(message)


def apply_rep_117(
    ranges: array.array[float], range_min: float, range_max: float
) -> array.array[float]:
    """Change ranges in metres in place as REP 117 requires, and return them.

    A range above `range_max` becomes +inf, and so does 0, which some lasers report if nothing
    reflects. A range below `range_min` becomes -inf. NaN stays NaN.
    """
    view = np.asarray(ranges)  # shares the memory of the array
    lowest, highest = np.minimum.reduce(view, initial=np.inf), np.maximum.reduce(view, initial=0.0)
    # most scans need no change; a NaN makes both numbers NaN, and comparisons with NaN are false
    if lowest > max(range_min, 0.0) and highest <= range_max:
        return ranges
    far = (view > range_max) | (view == 0.0)
    if far.any():
        view[far] = np.inf
    near = view < range_min
    if near.any():
        view[near] = -np.inf
    return ranges
