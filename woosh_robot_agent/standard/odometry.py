"""Odometry for a robot that reports only its pose in the map.

The chassis reports one pose, in its map, corrected by its localisation. REP 105 requires two
transforms: `odom` -> `base_link`, which never jumps, and `map` -> `odom`, which takes the jumps.
Therefore each report is compared with the previous one. Movement that fits the speeds in both
reports changes `odom` -> `base_link`. Any other movement, such as a pose set by a user, changes
`map` -> `odom`. Small corrections of the localisation look like driving, and become part of `odom`.
"""

from __future__ import annotations

import math

from woosh_robot_agent.standard.pose2d import Pose2D
from woosh_robot_agent.standard.report_time import ReportTime
from woosh_robot_agent.standard.velocity import LEVER, STANDSTILL, Velocity

_MAX_SPEED = 3.0
"""Upper bound of the robot's speed, in m/s."""
_MAX_TURN = math.tau
"""Upper bound of the robot's angular speed, in rad/s."""
_MAX_SPEED_GAIN = 1.0
"""Maximum excess of a reported speed over the mean speed since the previous report, in m/s."""
_MAX_TURN_GAIN = 2.0
"""The same for the angular speed, in rad/s."""
_MAX_DELAY = 0.3
"""Maximum delay of a report relative to the previous one, in seconds."""
_MIN_INTERVAL = 0.02
"""Lower bound of the interval by which a movement is divided, in seconds."""
_MAX_INTERVAL = 0.5
"""Upper bound of the interval between two reports of a moving robot, in seconds."""
_POSITION_TOLERANCE = 0.03
"""Maximum forward difference between reported pose and prediction from speeds, in metres."""
_HEADING_TOLERANCE = 0.03
"""Maximum difference between reported heading and prediction from speeds, in radians."""
_SIDEWAYS_TOLERANCE = 0.1
"""Maximum sideways movement that the speed to the left does not explain, in metres."""
_POSE_SET_INTERVAL = 0.5
"""Time after setting the robot's pose in which it may still report the old one, in seconds."""
_POSE_SET_TOLERANCE = 0.01
"""Tolerance of pose and heading within `_POSE_SET_INTERVAL` for a moving robot, in m and rad."""
_POSE_SET_TOLERANCE_AT_REST = 1e-4
"""The same for a standing robot."""
_MIN_SIDEWAYS = 0.004
"""Minimum sideways movement that is not taken for an inexact curve, in metres."""


class Odometry:
    """Pose of the robot in `odom`, and of `odom` in `map`.

    Attributes:
        pose: pose of the robot in `odom` at the last report; it never jumps.
        map_to_odom: pose of `odom` in `map`.
        velocity: velocity of the robot at the last report. The speed to the left is derived from
            the poses, as reports do not have it.
        time: time of the last reported pose, by the clock of `update`.
    """

    def __init__(self) -> None:
        self.pose = Pose2D()
        self.map_to_odom = Pose2D()
        self.velocity = STANDSTILL
        self.time = -math.inf
        self._reported = Pose2D()
        """Last reported pose, in `map`."""
        self._report_time = ReportTime()
        self._received = -math.inf
        """Time of receipt of the last report."""
        self._sideways = 0.0
        """Mean speed to the left between the last two reports, in m/s."""
        self._map_id = 0
        """Map of the last reported pose."""
        self._known = False
        """True if the next report can be compared with the last one."""
        self._pose_set_until = -math.inf
        """Time until which a report may show the jump to a pose that was set."""

    def lost(self, pose: Pose2D) -> None:
        """Note that reports were missed: the next one must not count as a movement.

        Args:
            pose: pose of the robot in `odom` that was published last.
        """
        self._known = False
        self.pose = pose

    def pose_set(self, time: float) -> None:
        """Note that the robot's pose was set at `time`: a following report may jump."""
        self._pose_set_until = time + _POSE_SET_INTERVAL

    def silent(self) -> None:
        """Note that the robot does not move sideways, because no report has come for a while."""
        self._sideways = 0.0
        if self.velocity.left:
            self.velocity = Velocity(self.velocity.forward, 0.0, self.velocity.turn)

    def update(
        self, reported: Pose2D, forward: float, turn: float, map_id: int, received: float
    ) -> bool:
        """Process a report of the chassis.

        Args:
            reported: pose in the map.
            forward: forward speed, in m/s.
            turn: angular speed, in rad/s.
            map_id: id of the map.
            received: time of receipt by a monotonic clock, in seconds.

        Returns:
            False if the reported speeds are impossible. They are then derived from the movement.
        """
        moved = reported.seen_from(self._reported)
        arc, before = moved.arc, self.velocity
        interval = min(max(received - self._received, 0.0), _MAX_INTERVAL)
        possible = self._possible(forward, turn, arc, interval)
        if not possible:
            forward, turn = self._mean_speeds(arc, interval)
        after = Velocity(forward, 0.0, turn)
        sideways = 0.0
        if not self._known:
            self.time = self._report_time.first(received)
            self.map_to_odom = reported * self.pose.inverse
        elif map_id != self._map_id or self._jumped(moved, arc, after, interval, received):
            self.time = self._report_time.first(received)
            mean_forward, mean_turn = (before.forward + forward) / 2, (before.turn + turn) / 2
            self.pose *= Pose2D.from_arc(mean_forward * interval, 0.0, mean_turn * interval)
            self.map_to_odom = reported * self.pose.inverse
            self._pose_set_until = -math.inf
        else:
            last = self.time
            self.time = self._report_time.next(received, arc, before, after)
            self.pose *= moved
            # a report after a long interval is a correction of the localisation
            if abs(arc[1]) > _MIN_SIDEWAYS and interval < _MAX_INTERVAL:
                sideways = arc[1] / max(self.time - last, _MIN_INTERVAL)
                sideways = max(-_MAX_SPEED, min(_MAX_SPEED, sideways))
        self.velocity = Velocity(forward, self._left(sideways), turn)
        self._sideways = sideways
        self._reported, self._map_id, self._received = reported, map_id, received
        self._known = True
        return possible

    def _left(self, sideways: float) -> float:
        """Return the speed to the left at a report, from the mean since the previous report."""
        slower = abs(sideways) < abs(self._sideways) and sideways * self._sideways > 0.0
        if not slower:
            return sideways
        left = sideways + (sideways - self._sideways) / 2
        return left if left * sideways > 0.0 else 0.0

    def _possible(
        self, forward: float, turn: float, arc: tuple[float, float, float], interval: float
    ) -> bool:
        """Return True if the robot can have these speeds after its last movement."""
        if abs(forward) > _MAX_SPEED or abs(turn) > _MAX_TURN:
            return False
        if not self._known:
            return True
        seconds = max(interval, _MIN_INTERVAL)
        return (
            abs(forward) <= abs(arc[0]) / seconds + _MAX_SPEED_GAIN
            and abs(turn) <= abs(arc[2]) / seconds + _MAX_TURN_GAIN
        )

    def _mean_speeds(self, arc: tuple[float, float, float], interval: float) -> tuple[float, float]:
        """Return the mean speeds since the last report, or zeros if they are impossible too."""
        seconds = max(interval, _MIN_INTERVAL)
        forward, turn = arc[0] / seconds, arc[2] / seconds
        if not self._known or abs(forward) > _MAX_SPEED or abs(turn) > _MAX_TURN:
            return 0.0, 0.0
        return forward, turn

    def _jumped(
        self,
        moved: Pose2D,
        arc: tuple[float, float, float],
        after: Velocity,
        interval: float,
        time: float,
    ) -> bool:
        """Return True if the movement since the last report cannot have been driven."""
        before = self.velocity
        forward, turn = (before.forward + after.forward) / 2, (before.turn + after.turn) / 2
        # the duration follows from the movement, because the times of receipt are inexact
        turns_mostly = abs(turn) > abs(forward) / LEVER
        speed, way = (turn, arc[2]) if turns_mostly else (forward, arc[0])
        duration = max(0.0, min(way / speed if speed else 0.0, interval + _MAX_DELAY))
        error = moved.seen_from(Pose2D.from_arc(forward * duration, 0.0, turn * duration))
        if time <= self._pose_set_until:
            limit = _POSE_SET_TOLERANCE
            if not (before.moving or after.moving):
                limit = _POSE_SET_TOLERANCE_AT_REST
            return error.distance > limit or abs(error.theta) > limit
        # the robot may have changed its speed at any time since the last report
        forward_margin = abs(after.forward - before.forward) * interval / 2
        turn_margin = abs(after.turn - before.turn) * interval / 2
        position_tolerance = _POSITION_TOLERANCE + forward_margin
        heading_tolerance = _HEADING_TOLERANCE + turn_margin
        # then the duration is inexact, and so is what it predicts of the other movement
        if turns_mostly:
            position_tolerance += abs(forward) * min(turn_margin / abs(turn), interval)
        elif forward:
            heading_tolerance += abs(turn) * min(forward_margin / abs(forward), interval)
        return (
            abs(error.x) > position_tolerance
            or abs(error.theta) > heading_tolerance
            or abs(error.y) > _SIDEWAYS_TOLERANCE + abs(self._sideways) * interval
        )
