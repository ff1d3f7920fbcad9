"""Transform poses into the frame of the map, from the robot's own frames and from frames on /tf."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import PoseStamped
from rclpy.qos import QoSProfile

from woosh_robot_agent.link.reports import RecentDict
from woosh_robot_agent.ros.qos import latched
from woosh_robot_agent.ros.standard.part import PartContext
from woosh_robot_agent.ros.standard.poses import Pose2D, from_pose, to_pose

_WAIT = 1.0
"""Maximum wait for a transform, in seconds. The first wait includes the discovery of the publishers
of /tf."""
_MAX_AGE = 10.0
"""Maximum age of a transform on /tf that is used, in seconds; tf2 keeps transforms as long."""
_MAX_FRAMES = 10_000
"""Maximum number of frames whose transforms are kept."""
_DEPTH = 100
"""Queue size of the subscriptions, as tf2 has it."""

Transform: TypeAlias = npt.NDArray[np.float64]
"""Pose of a child frame in its parent frame, in metres: a homogeneous matrix of 4 x 4 numbers."""


def _transform(shift: Any, rotation: Any) -> Transform:
    """Return the transform in two messages: a vector and a quaternion.

    Raises:
        ValueError: a number is not finite, or the quaternion is not a rotation.
    """
    q = (rotation.x, rotation.y, rotation.z, rotation.w)
    length = math.hypot(*q)
    # a rounded quaternion is accepted, and normalised
    if not all(map(math.isfinite, (shift.x, shift.y, shift.z))) or not 0.7 <= length <= 1.4:
        raise ValueError("it is not a rotation and a shift of finite numbers")
    x, y, z, w = (each / length for each in q)
    return np.array(
        (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w), shift.x),
            (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w), shift.y),
            (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y), shift.z),
            (0.0, 0.0, 0.0, 1.0),
        )
    )


def _from_pose2d(pose: Pose2D) -> Transform:
    message = to_pose(pose)
    return _transform(message.position, message.orientation)


def _in_plane(transform: Transform) -> Pose2D:
    """Return a transform as a pose in the plane, without height and tilt."""
    yaw = math.atan2(transform[1, 0], transform[0, 0])
    return Pose2D(float(transform[0, 3]), float(transform[1, 3]), yaw)


_UNKNOWN_POSE = (
    "the pose of the frame {} in the map is not known: wait for the link to the robot, and keep "
    "the part odom switched on for the frame of the odometry"
)


class _Edge(NamedTuple):
    """A transform as it was last published on /tf: an edge of the tree of frames.

    Attributes:
        parent: name of the parent frame.
        transform: pose of the child frame in the parent frame.
        received: monotonic time of receipt; infinite for a static transform, so it never expires.
    """

    parent: str
    transform: Transform
    received: float


class Frames:
    """Transforms poses into the frame of the map. Used in the link thread.

    The frames of the map, of the robot and of its odometry are known without /tf. /tf is subscribed
    to only from the first pose in another frame on, because a busy /tf costs CPU time. The latest
    transforms are used, whatever the stamp of the pose.

    Args:
        robot_pose: returns the robot's pose in the map; None if it is unknown.
        map_to_odom: returns the pose of the frame of the odometry in the map; None if it is
            unknown.
    """

    def __init__(
        self,
        context: PartContext,
        robot_pose: Callable[[], Pose2D | None],
        map_to_odom: Callable[[], Pose2D | None],
    ) -> None:
        self._context = context
        self._own: dict[str, Callable[[], Pose2D | None]] = {
            context.frame("map"): Pose2D,  # the identity
            context.frame("odom"): map_to_odom,
            context.frame("base"): robot_pose,
        }
        """Functions that return the poses of the known frames in the map."""
        self._edges = RecentDict[str, _Edge](_MAX_FRAMES)
        """Transforms on /tf, by their child frame."""
        self._changed = asyncio.Event()
        """Set when a transform has come."""
        self._is_subscribed = False

    async def to_map_frame(self, stamped: PoseStamped) -> None:
        """Transform a pose, in place, into the frame of the map.

        Raises:
            ValueError: the pose is invalid, or there is no transform; the text says what to do.
        """
        map_frame = self._context.frame("map")
        from_pose(stamped.pose)  # raises an error that says what is wrong
        frame = stamped.header.frame_id.lstrip("/")
        if not frame:  # a message that was left blank must not move the robot
            raise ValueError(f"the pose has no frame: set header.frame_id, e.g. to {map_frame}")
        if frame == map_frame:
            stamped.header.frame_id = map_frame
            return
        origin = await self._find(frame)
        pose = origin @ _transform(stamped.pose.position, stamped.pose.orientation)
        stamped.header.frame_id = map_frame
        stamped.pose = to_pose(_in_plane(pose))
        from_pose(stamped.pose)  # the transform may have made it too large

    async def _find(self, frame: str) -> Transform:
        """Return the pose of a frame in the map; wait up to `_WAIT` for transforms on /tf.

        Raises:
            ValueError: there is no transform of the frame.
        """
        loop = asyncio.get_running_loop()
        until = loop.time() + _WAIT
        while True:
            pose_or_reason = self._look_up(frame)
            if not isinstance(pose_or_reason, str):
                return pose_or_reason
            if frame in self._own:  # on /tf it comes from this agent: do not wait
                raise ValueError(pose_or_reason)
            self._subscribe()
            self._changed.clear()
            timer = loop.call_at(until, self._changed.set)
            await self._changed.wait()
            timer.cancel()
            if loop.time() >= until:
                raise ValueError(pose_or_reason)

    def _look_up(self, frame: str) -> Transform | str:
        """Return the pose of a frame in the map, or the reason why there is none."""
        try:
            above: dict[str, Transform] = {}  # poses of `frame` in the frames above it
            for ancestor, pose_in_ancestor in self._climb(frame):
                known = self._own[ancestor]() if ancestor in self._own else None
                if known is not None:  # /tf above it may be of another odometry
                    return _from_pose2d(known) @ pose_in_ancestor
                above[ancestor] = pose_in_ancestor
            for own, find_pose in self._own.items():
                for ancestor, own_pose in self._climb(own):
                    if ancestor in above:  # this frame connects `frame` with `own`
                        pose = find_pose()
                        if pose is None:
                            return _UNKNOWN_POSE.format(own)
                        return _from_pose2d(pose) @ np.linalg.inv(own_pose) @ above[ancestor]
        except ValueError as error:
            return str(error)
        top = list(above)[-1]
        unconnected = f"{top}, which is above {frame}," if top != frame else frame
        return (
            f"nothing on /tf connects the frame {unconnected} with one of the robot: publish its "
            f"transform, or give the pose in one of {', '.join(self._own)}"
        )

    def _climb(self, frame: str) -> Iterator[tuple[str, Transform]]:
        """Yield a frame and each frame above it, each with the pose of `frame` in it.

        Raises:
            ValueError: a transform is too old.
        """
        pose = np.eye(4)
        seen = {frame}
        yield frame, pose
        while (edge := self._edges.get(frame)) is not None and edge.parent not in seen:
            if time.monotonic() - edge.received > _MAX_AGE:
                raise ValueError(
                    f"the last transform of the frame {frame} came more than {_MAX_AGE:g} s ago"
                )
            pose = edge.transform @ pose
            frame = edge.parent
            seen.add(frame)
            yield frame, pose

    def _subscribe(self) -> None:
        """Subscribe to /tf and /tf_static, unless that has been done.

        Raises:
            ValueError: tf2_msgs is not installed.
        """
        if self._is_subscribed:
            return
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            raise ValueError(
                "tf2_msgs is not installed, so only the robot's own frames are known"
            ) from None

        self._is_subscribed = True
        robot = self._context
        for topic, profile, is_static in (
            ("/tf", QoSProfile(depth=_DEPTH), False),
            ("/tf_static", latched(_DEPTH), True),
        ):
            callback = partial(robot.thread.call, partial(self._received, is_static=is_static))
            robot.node.create_subscription(TFMessage, topic, callback, profile)

    def _received(self, message: Any, *, is_static: bool) -> None:
        received = math.inf if is_static else time.monotonic()
        for each in message.transforms:
            try:
                transform = _transform(each.transform.translation, each.transform.rotation)
            except ValueError:
                continue  # as tf2 does: the last valid one stays
            parent = each.header.frame_id.lstrip("/")
            self._edges[each.child_frame_id.lstrip("/")] = _Edge(parent, transform, received)
        self._changed.set()
