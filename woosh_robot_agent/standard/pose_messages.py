"""Conversion between poses in the plane and ROS pose messages."""

from __future__ import annotations

import math
from typing import Any

from geometry_msgs.msg import Pose

from woosh_robot_agent.standard.pose2d import Pose2D

_MAX_FLOAT = 3.4028234663852886e38
"""The largest 32-bit number."""


def to_pose(pose: Pose2D) -> Pose:
    """Return a pose as geometry_msgs/Pose."""
    message = Pose()
    message.position.x, message.position.y = pose.x, pose.y
    message.orientation.z, message.orientation.w = pose.quaternion
    return message


def from_pose_in(required_frame: str, frame: str, message: Any) -> Pose2D:
    """Return the pose in a geometry_msgs/Pose that a client gave in `frame`.

    Raises:
        ValueError: `frame` is not the required one, or the pose is invalid; the text says what to
            do.
    """
    if frame not in ("", required_frame):
        raise ValueError(
            f"the pose must be in the frame {required_frame}, not in {frame}; set the fixed frame "
            f"to {required_frame}"
        )
    return from_pose(message)


def from_pose(message: Any) -> Pose2D:
    """Return the pose in a geometry_msgs/Pose.

    Raises:
        ValueError: it has numbers that are not finite, or not in the robot's 32-bit numbers, or
            its orientation is not a rotation.
    """
    q, position = message.orientation, message.position
    numbers = (position.x, position.y, q.x, q.y, q.z, q.w)
    if not all(abs(number) <= _MAX_FLOAT for number in numbers):
        raise ValueError(f"the pose has numbers that are not finite, or too large: {numbers}")
    if not 0.5 <= q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w <= 2.0:
        raise ValueError("the orientation is not a unit quaternion")
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return Pose2D(position.x, position.y, yaw)
