"""Poses of the chassis as ROS's messages."""

from __future__ import annotations

import math
from typing import Any

from geometry_msgs.msg import Pose, PoseStamped

from woosh_robot_agent.standard.plane import Plane


def pose_of(plane: Plane) -> Pose:
    """A pose in the plane as a pose in space."""
    pose = Pose()
    pose.position.x, pose.position.y = plane.x, plane.y
    pose.orientation.z, pose.orientation.w = plane.quaternion
    return pose


def stamped(plane: Plane, frame: str, stamp: Any) -> PoseStamped:
    """A pose in `frame` at `stamp`."""
    message = PoseStamped(pose=pose_of(plane))
    message.header.frame_id = frame
    message.header.stamp = stamp
    return message


def plane_in(wanted: str, frame: str, pose: Any) -> Plane:
    """A pose that somebody gives in `frame`, in the plane of the frame `wanted`.

    Raises:
        ValueError: It is in another frame, or it makes no sense; the text says what to do.
    """
    if frame not in ("", wanted):
        raise ValueError(f"it is in the frame {frame}; set the fixed frame to {wanted}")
    return plane_of(pose)


def plane_of(pose: Any) -> Plane:
    """A pose in space as one in the plane.

    Raises:
        ValueError: It has numbers that are not finite, or its orientation is no rotation.
    """
    q, at = pose.orientation, pose.position
    numbers = (at.x, at.y, q.x, q.y, q.z, q.w)
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"the pose has numbers that are not finite: {numbers}")
    if q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w < 0.5:
        raise ValueError("the orientation is not a unit quaternion")
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return Plane(at.x, at.y, yaw)
