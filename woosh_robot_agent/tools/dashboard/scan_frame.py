"""A laser scan as a binary message: a tenth of the size of the JSON."""

from __future__ import annotations

import array
import math
import struct
import sys

from woosh_robot_agent.pb.robot.robot_pb2 import ScannerData

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
