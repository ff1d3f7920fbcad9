"""The pose of a robot between its reports.

A robot reports about five times a second while it moves. Between the reports, its pose is predicted
from the last one: the robot drives on at the reported velocity, along an exact arc. If it slowed
down between the last two reports, it continues to slow down until it stands. If it accelerated, it
keeps its speed, because it may have reached the commanded one.

Each report starts a new prediction. The pose must not jump, so the difference between the old and
the new prediction is blended out over 0.15 s. If a report comes late, the predictions pause before
it. Then only the movement that the robot cannot have made in the pause is blended out.
"""

from __future__ import annotations

import math

from woosh_robot_agent.standard.pose2d import Pose2D
from woosh_robot_agent.standard.velocity import STANDSTILL, Velocity

HORIZON = 0.3
"""Maximum time between a report and a pose that is predicted from it, in seconds."""
_BLEND = 0.15
"""Time over which the error of a prediction is blended out, in seconds."""
_FIRST_STEP = 0.05
"""Part of `_BLEND` that may have passed at the first prediction from a report, in seconds."""
_LONGEST_PAUSE = 1.5
"""Maximum time between two predictions that must not differ by a jump, in seconds."""
_MIN_INTERVAL = 0.01
"""Minimum interval between two reports from which an acceleration is derived, in seconds."""
_MAX_INTERVAL = 0.5
"""Maximum interval between two reports from which an acceleration is derived, in seconds."""


class Prediction:
    """Predicts the pose from reports, without jumps.

    All times are those of one monotonic clock, in seconds.
    """

    def __init__(self) -> None:
        self._pose = Pose2D()
        """Pose in the last report."""
        self._velocity = STANDSTILL
        self._time = -math.inf
        """Time of the last report."""
        self._before = STANDSTILL
        """Velocity at the report before the last one."""
        self._interval = math.inf
        """Time between these two reports, in seconds."""
        self._acceleration = STANDSTILL
        """Mean acceleration in this interval, in m/s² and rad/s²."""
        self._is_new = False
        """True if nothing has been predicted from the last report yet."""
        self._last_time = -math.inf
        """Time of the last predicted pose."""
        self._last = Pose2D()
        """The last predicted pose."""
        self._last_velocity = STANDSTILL
        """Reported velocity from which it was predicted."""
        self._error = Pose2D()
        """Difference between the old and the new prediction, at the time `_error_time`."""
        self._error_time = -math.inf

    @property
    def velocity(self) -> Velocity:
        """The velocity in the last report, or zero after `stand`."""
        return self._velocity

    @property
    def last(self) -> Pose2D:
        """The last predicted pose, or that of the last report if it is newer."""
        return self._last if self._last_time >= self._time else self._pose

    def report(self, pose: Pose2D, velocity: Velocity, time: float) -> None:
        """Start a new prediction.

        Args:
            pose: reported pose.
            velocity: reported velocity.
            time: time of the pose and the velocity; may be before that of the last prediction.
        """
        self._before, self._interval = self._velocity, time - self._time
        self._pose, self._velocity, self._time = pose, velocity, time
        self._is_new = True

    def stand(self) -> None:
        """Note that the robot stands at the pose of the last report, because no other followed."""
        if self._velocity != STANDSTILL:
            self.report(self._pose, STANDSTILL, self._time)

    def valid(self, time: float) -> bool:
        """Return True if the pose can be predicted: the robot stands, or has reported recently."""
        return not self._velocity.moving or time - self._time <= HORIZON

    def predict(self, time: float) -> tuple[Pose2D, Velocity]:
        """Return the pose and the velocity of the robot.

        Args:
            time: time of the pose; must not be before that of the previous call.
        """
        if self._is_new:
            self._start(time)
        pose, share = self._at(time), 1.0 - (time - self._error_time) / _BLEND
        if share > 0.0:
            error = self._error
            pose = Pose2D(
                pose.x + share * error.x,
                pose.y + share * error.y,
                math.remainder(pose.theta + share * error.theta, math.tau),
            )
        self._last_time, self._last, self._last_velocity = time, pose, self._velocity
        elapsed, velocity, change = time - self._time, self._velocity, self._acceleration
        if elapsed > 0.0 and velocity.moving:
            velocity = Velocity(
                _slowed(velocity.forward, change.forward, elapsed),
                _slowed(velocity.left, change.left, elapsed),
                _slowed(velocity.turn, change.turn, elapsed),
            )
        return pose, velocity

    def _start(self, time: float) -> None:
        """Start to predict from a new report.

        Args:
            time: time of the first prediction.
        """
        self._is_new = False
        interval, now, before = self._interval, self._velocity, self._before
        if not _MIN_INTERVAL <= interval <= _MAX_INTERVAL:
            interval, before = 1.0, now  # the acceleration is not known
        self._acceleration = Velocity(
            (now.forward - before.forward) / interval,
            (now.left - before.left) / interval,
            (now.turn - before.turn) / interval,
        )
        pause = time - self._last_time
        if pause < _BLEND:
            self._error = _difference(self._last, self._at(self._last_time))
            self._error_time = max(self._last_time, time - _FIRST_STEP)
        elif pause <= _LONGEST_PAUSE:
            pose = self._at(time)
            self._error = _difference(self._reachable(pose, pause), pose)
            self._error_time = time
        else:  # nobody has seen the last pose for long
            self._error_time = -math.inf

    def _reachable(self, pose: Pose2D, seconds: float) -> Pose2D:
        """Return the pose nearest to `pose` that the robot can reach from the last predicted one.

        Its speeds are between zero and those before and after.
        """
        forward, left, turn = pose.seen_from(self._last).arc
        before, now = self._last_velocity, self._velocity
        return self._last * Pose2D.from_arc(
            _limited(forward, before.forward, now.forward, seconds),
            _limited(left, before.left, now.left, seconds),
            _limited(turn, before.turn, now.turn, seconds),
        )

    def _at(self, time: float) -> Pose2D:
        """Return the pose at a time as predicted from the last report, without blending."""
        elapsed = max(-HORIZON, min(time - self._time, HORIZON))
        velocity, change = self._velocity, self._acceleration
        if elapsed > 0.0:
            if not velocity.moving:
                return self._pose
            # `from_arc` is exact for a constant velocity
            forward = _mean(velocity.forward, change.forward, elapsed)
            left = _mean(velocity.left, change.left, elapsed)
            turn = _mean(velocity.turn, change.turn, elapsed)
        else:  # between the last two reports, where the velocity changed from one to the other
            half = max(elapsed, -self._interval) / 2
            forward = velocity.forward + change.forward * half
            left = velocity.left + change.left * half
            turn = velocity.turn + change.turn * half
        return self._pose * Pose2D.from_arc(forward * elapsed, left * elapsed, turn * elapsed)


def _slowed(speed: float, acceleration: float, seconds: float) -> float:
    """Return the speed after some time. Only a robot that slows down changes it, down to zero."""
    if speed * acceleration >= 0.0:
        return speed
    slowed = speed + acceleration * seconds
    return slowed if slowed * speed > 0.0 else 0.0


def _mean(speed: float, acceleration: float, seconds: float) -> float:
    """Return the mean speed during some time, as `_slowed` changes it."""
    if speed * acceleration >= 0.0:
        return speed
    moving = min(seconds, -speed / acceleration)
    return (speed + acceleration * moving / 2) * moving / seconds


def _limited(way: float, before: float, now: float, seconds: float) -> float:
    """Return the way, limited to what speeds between zero and these two can cover."""
    return max(min(0.0, before, now) * seconds, min(max(0.0, before, now) * seconds, way))


def _difference(one: Pose2D, other: Pose2D) -> Pose2D:
    """Return the difference of two poses, number by number."""
    return Pose2D(
        one.x - other.x, one.y - other.y, math.remainder(one.theta - other.theta, math.tau)
    )
