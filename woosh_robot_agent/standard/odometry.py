"""Odometry for a robot that reports only its pose in the map.

The chassis reports one pose, in its map, corrected by its localisation. REP 105 requires two
transforms: `odom` -> `base_link`, which never jumps, and `map` -> `odom`, which takes the jumps.
Therefore each report is compared with the one before. Movement that fits the speeds in both reports
changes `odom` -> `base_link`. Any other movement, such as a pose set by a user, changes `map` ->
`odom`. Small corrections of the localisation look like driving, and become part of `odom`.
"""

from __future__ import annotations

import math

from woosh_robot_agent.standard.pose2d import Pose2D

MAX_SPEED = 1.5
"""Upper bound of the robot's speed, in m/s."""
_MAX_DELAY = 0.3
"""Maximum delay of a report relative to the one before, in seconds."""
_MAX_INTERVAL = 0.5
"""Maximum interval between two reports of a moving robot, in seconds."""
_POSITION_TOLERANCE = 0.03
"""Maximum forward difference between reported pose and prediction from speeds, in metres."""
_HEADING_TOLERANCE = 0.03
"""Maximum difference between reported heading and prediction from speeds, in radians."""
_SIDEWAYS_TOLERANCE = 0.1
"""Maximum sideways movement between two reports, in metres; reports have no sideways speed."""
_POSE_SET_INTERVAL = 0.3
"""Time after setting the robot's pose in which it may still report the old one, in seconds."""
_POSE_SET_TOLERANCE = 0.01
"""Tolerance within `_POSE_SET_INTERVAL` while the robot moves, in metres or radians."""
_POSE_SET_TOLERANCE_AT_REST = 1e-4
"""Tolerance within `_POSE_SET_INTERVAL` while the robot stands, in metres or radians."""
_LEVER = 0.3
"""Distance from the robot's centre at which turning counts as much as driving, in metres."""
_MIN_SIDEWAYS = 0.004
"""Minimum sideways movement, in metres; a smaller one is part of a curve."""


class Odometry:
    """Pose of the robot in `odom`, and of `odom` in `map`.

    Attributes:
        pose: pose of the robot in `odom`; it never jumps.
        map_to_odom: pose of `odom` in `map`.
        forward: forward speed, in m/s.
        sideways: speed to the left, in m/s; derived from the poses, as reports do not have it.
        turn: angular speed, in rad/s.
    """

    def __init__(self) -> None:
        self.pose = Pose2D()
        self.map_to_odom = Pose2D()
        self.forward = 0.0
        self.sideways = 0.0
        self.turn = 0.0
        self._time = -math.inf
        self._map_id = 0
        self._known = False
        self._pose_set_until = -math.inf

    @property
    def map_pose(self) -> Pose2D:
        """Last reported pose of the robot in `map`."""
        return self.map_to_odom * self.pose

    @property
    def moving(self) -> bool:
        """True if the robot moved at the last report."""
        return bool(self.forward or self.turn)

    def lost(self) -> None:
        """Note that reports were missed: the next one must not count as a movement."""
        self._known = False

    def pose_set(self, time: float) -> None:
        """Note that the robot's pose was set at `time`: a following report may jump."""
        self._pose_set_until = time + _POSE_SET_INTERVAL

    def silent(self) -> None:
        """Note that there was no report for so long that the robot must be standing."""
        self.sideways = 0.0

    def update(
        self, reported: Pose2D, forward: float, turn: float, map_id: int, time: float
    ) -> None:
        """Process a report of the chassis.

        Args:
            reported: pose in the map.
            forward: forward speed, in m/s.
            turn: angular speed, in rad/s.
            map_id: id of the map.
            time: time of receipt by a monotonic clock, in seconds.
        """
        moved = self.map_pose.inverse * reported
        interval = min(max(time - self._time, 0.0), _MAX_INTERVAL)
        if not self._known:
            self.map_to_odom = reported * self.pose.inverse
            self.sideways = 0.0
        elif map_id != self._map_id or self._jumped(moved, forward, turn, interval, time):
            self.pose = self.pose * _arc(forward, turn, interval)
            self.map_to_odom = reported * self.pose.inverse
            self.sideways = 0.0
            self._pose_set_until = -math.inf
        else:
            self.pose = self.pose * moved
            shift = moved.y if abs(moved.y) > _MIN_SIDEWAYS else 0.0
            speed = shift / max(interval, 0.02)
            self.sideways = max(-MAX_SPEED, min(MAX_SPEED, speed))
        self.forward, self.turn = forward, turn
        self._time, self._map_id = time, map_id
        self._known = True

    def _jumped(
        self, moved: Pose2D, forward: float, turn: float, interval: float, time: float
    ) -> bool:
        """Return True if the robot cannot have driven the movement since the last report."""
        mean_forward, mean_turn = (forward + self.forward) / 2, (turn + self.turn) / 2
        # the duration follows from the movement, because the times of receipt are inexact
        turns_mostly = abs(mean_turn) > abs(mean_forward) / _LEVER
        speed, way = (mean_turn, moved.theta) if turns_mostly else (mean_forward, moved.x)
        duration = way / speed if speed else 0.0
        driven = _arc(mean_forward, mean_turn, max(0.0, min(duration, interval + _MAX_DELAY)))
        error = driven.inverse * moved
        if time <= self._pose_set_until:
            standing = not (forward or turn or self.forward or self.turn)
            limit = _POSE_SET_TOLERANCE_AT_REST if standing else _POSE_SET_TOLERANCE
            return error.distance > limit or abs(error.theta) > limit
        return (
            abs(error.x) > _POSITION_TOLERANCE
            or abs(error.theta) > _HEADING_TOLERANCE
            or abs(error.y) > _SIDEWAYS_TOLERANCE
        )


def _arc(forward: float, turn: float, seconds: float) -> Pose2D:
    """Return the movement of the robot at constant speeds."""
    length, angle = forward * seconds, turn * seconds
    return Pose2D(length * math.cos(angle / 2), length * math.sin(angle / 2), angle)
