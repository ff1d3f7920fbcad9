"""Poses in the plane and as ROS messages. Lengths in metres, angles in radians (REP 103)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from geometry_msgs.msg import Pose

_RESIDUAL_SPEED = 0.005
"""Maximum speed of a robot that stands, in m/s."""
_RESIDUAL_TURN = 0.005
"""Maximum angular speed of a robot that stands, in rad/s."""
LEVER = 0.3
"""Radius that converts angles to lengths, to compare turning with driving, in metres."""


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity in the robot's frame.

    Attributes:
        forward: speed along x, in m/s.
        left: speed along y, in m/s.
        turn: angular speed, counter-clockwise, in rad/s.
    """

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0

    @property
    def moving(self) -> bool:
        """True unless all speeds are so small that the robot stands."""
        return (
            abs(self.forward) > _RESIDUAL_SPEED
            or abs(self.left) > _RESIDUAL_SPEED
            or abs(self.turn) > _RESIDUAL_TURN
        )


STANDSTILL = Velocity()


class Arc(NamedTuple):
    """A movement at constant velocities in the robot's frame.

    Attributes:
        forward: distance driven along x, in metres.
        left: distance driven along y, in metres.
        turn: angle turned meanwhile, counter-clockwise, in radians.
    """

    forward: float
    left: float
    turn: float


@dataclass(frozen=True, slots=True)
class Pose2D:
    """Pose of a child frame in a parent frame: rotation by `theta`, then shift by (`x`, `y`).

    In metres and radians.
    """

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    @classmethod
    def from_message(cls, pose: Any) -> Pose2D:
        """Return the pose in a message of the chassis with the fields `x`, `y` and `theta`.

        Raises:
            ValueError: a number is not finite.
        """
        check_finite("pose", pose.x, pose.y, pose.theta)
        return cls(pose.x, pose.y, pose.theta)

    @classmethod
    def from_arc(cls, forward: float, left: float, turn: float) -> Pose2D:
        """Return the pose at the end of an `Arc` with these values, in the frame of its start."""
        half_turn = turn / 2  # angle between the chord and the direction at the start
        chord = _chord_ratio(turn)
        cos, sin = chord * math.cos(half_turn), chord * math.sin(half_turn)
        return cls(cos * forward - sin * left, sin * forward + cos * left, turn)

    @property
    def arc(self) -> Arc:
        """The movement that ends at this pose; the inverse of `from_arc`."""
        half_turn = self.theta / 2
        chord = _chord_ratio(self.theta)
        cos, sin = math.cos(half_turn) / chord, math.sin(half_turn) / chord
        return Arc(cos * self.x + sin * self.y, cos * self.y - sin * self.x, self.theta)

    def __mul__(self, other: Pose2D) -> Pose2D:
        """Transform `other` from this pose's child frame to this pose's parent frame."""
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        return Pose2D(
            self.x + cos * other.x - sin * other.y,
            self.y + sin * other.x + cos * other.y,
            math.remainder(self.theta + other.theta, math.tau),
        )

    @property
    def inverse(self) -> Pose2D:
        """Pose of the parent frame in the child frame."""
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        return Pose2D(-cos * self.x - sin * self.y, sin * self.x - cos * self.y, -self.theta)

    def seen_from(self, origin: Pose2D) -> Pose2D:
        """Return this pose in the child frame of `origin`; both have the same parent frame."""
        cos, sin = math.cos(origin.theta), math.sin(origin.theta)
        x, y = self.x - origin.x, self.y - origin.y
        theta = math.remainder(self.theta - origin.theta, math.tau)
        return Pose2D(cos * x + sin * y, cos * y - sin * x, theta)

    @property
    def distance(self) -> float:
        """Distance from the origin, in metres."""
        return math.hypot(self.x, self.y)

    @property
    def quaternion(self) -> tuple[float, float]:
        """Z and w of the rotation's quaternion; x and y are 0."""
        return math.sin(self.theta / 2), math.cos(self.theta / 2)


def check_finite(name: str, *numbers: float) -> None:
    """Check numbers of the chassis that become part of a standard message.

    Raises:
        ValueError: a number is infinite or NaN; the text has `name` and all numbers.
    """
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"{name} is not finite: {', '.join(f'{each:g}' for each in numbers)}")


def _chord_ratio(turn: float) -> float:
    """Return the chord of an arc divided by the arc's length; `turn` is the arc's angle."""
    half_turn = turn / 2
    return math.sin(half_turn) / half_turn if abs(half_turn) > 1e-4 else 1.0


_MAX_FLOAT = 3.4028234663852886e38
"""The largest 32-bit number; the chassis's poses have 32 bits."""


def to_pose(pose: Pose2D) -> Pose:
    """Return a pose as geometry_msgs/Pose."""
    message = Pose()
    message.position.x, message.position.y = pose.x, pose.y
    message.orientation.z, message.orientation.w = pose.quaternion
    return message


def from_pose_in(required_frame: str, frame: str, message: Any) -> Pose2D:
    """Return the pose in a geometry_msgs/Pose, and check the frame in which a client gave it.

    Raises:
        ValueError: `frame` is not the required one, or the pose is invalid; the text says what to
            do.
    """
    if not frame:  # a message that was left blank must not move the robot
        raise ValueError(f"the pose has no frame: set header.frame_id to {required_frame}")
    if frame != required_frame:
        raise ValueError(
            f"the pose must be in the frame {required_frame}, not in {frame}; set the fixed frame "
            f"to {required_frame}"
        )
    return from_pose(message)


def from_pose(message: Any) -> Pose2D:
    """Return the pose in a geometry_msgs/Pose.

    Raises:
        ValueError: a number is not finite, or too large for the robot's 32-bit numbers, or the
            orientation is not a rotation.
    """
    q, position = message.orientation, message.position
    numbers = (position.x, position.y, q.x, q.y, q.z, q.w)
    if not all(abs(number) <= _MAX_FLOAT for number in numbers):
        raise ValueError(f"the pose has numbers that are not finite, or too large: {numbers}")
    # a rounded quaternion is accepted
    if not 0.5 <= q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w <= 2.0:
        raise ValueError("the orientation is not a unit quaternion")
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return Pose2D(position.x, position.y, yaw)
