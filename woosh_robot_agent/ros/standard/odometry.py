"""Odometry for a robot that reports only its pose in the map.

The chassis reports one pose, in its map, corrected by its localisation. REP 105 requires two
transforms: `odom` -> `base_link`, which never jumps, and `map` -> `odom`, which takes the jumps.
Therefore each report is compared with the previous one. Movement that fits the speeds in both
reports changes `odom` -> `base_link`. Any other movement, such as a pose set by a user, changes
`map` -> `odom`. Small corrections of the localisation look like driving, and become part of `odom`.

A robot reports about five times a second while it moves. Between the reports, its pose is
predicted from the last one: the robot drives on at the reported velocity, along an exact arc. If
it slowed down between the last two reports, it continues to slow down until it stands. If it
accelerated, it keeps its speed, because it may have reached the commanded one.

Each report starts a new prediction. The pose must not jump, so the difference between the old and
the new prediction is blended out over 0.15 s. If a report comes late, the predictions pause before
it. Then only the movement that the robot cannot have made in the pause is blended out.
"""

from __future__ import annotations

import math

from woosh_robot_agent.ros.standard.poses import LEVER, STANDSTILL, Arc, Pose2D, Velocity

_MIN_SPEED = 0.1
"""Minimum mean speed from which the duration of a movement is derived, in m/s."""
_TOLERANCE = 1.1
"""Factor by which a report may exceed the duration derived from its movement before it counts as
delayed, because the reported speeds are inexact."""
_MAX_REPORT_DELAY = 0.25
"""Maximum delay of a report that is corrected, in seconds."""
_CORRECTION = 0.7
"""Share of a delay that is corrected. It is below 1, so that the estimate follows a delay that
lasts."""


def report_time(received: float, last: float, arc: Arc, before: Velocity, after: Velocity) -> float:
    """Return when the pose in a report was measured, without the jitter of the network.

    If the time of receipt were used for a delayed report, the pose would fall behind, and would
    have to catch up with the next report. The movement between two reports, divided by the
    reported speeds, gives the time between them. A report that comes later was delayed.

    Args:
        received: time of receipt, in seconds. The result is never after it.
        last: the result for the previous report.
        arc: movement since the previous report.
        before: velocity in the previous report.
        after: velocity in this report.
    """
    forward = (before.forward + after.forward) / 2
    edge = (before.turn + after.turn) / 2 * LEVER  # speed of a point beside the robot
    square = forward * forward + edge * edge
    if before.moving and square > _MIN_SPEED * _MIN_SPEED:
        # the duration that fits both movements best, by least squares
        duration = (forward * arc.forward + edge * arc.turn * LEVER) / square
        delay = received - last - _TOLERANCE * max(duration, 0.0)
        if 0.0 < delay < _MAX_REPORT_DELAY:
            return received - _CORRECTION * delay
    return received


HORIZON = 0.3
"""Maximum time between a report and a pose that is predicted from it, in seconds."""
_BLEND = 0.15
"""Time over which the error of a prediction is blended out, in seconds."""
_FIRST_STEP = 0.05
"""Maximum part of `_BLEND` that has passed at the first prediction from a report, in seconds. With
more, that prediction would jump."""
_LONGEST_PAUSE = 1.5
"""Maximum time between two predictions that must not differ by a jump, in seconds."""
_MIN_REPORT_INTERVAL = 0.01
"""Minimum interval between two reports from which an acceleration is derived, in seconds."""
_MAX_INTERVAL = 0.5
"""Maximum interval between two reports from which an acceleration is derived, and upper bound of
the interval between two reports of a moving robot, in seconds."""


class Prediction:
    """Predicts the pose from reports, without jumps.

    All times are of the same monotonic clock, in seconds.
    """

    def __init__(self) -> None:
        self._pose = Pose2D()
        """Pose in the last report."""
        self.velocity = STANDSTILL
        """The velocity in the last report, or zero after `stand`."""
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
        """Reported velocity from which the last pose was predicted."""
        self._error = Pose2D()
        """Difference between the old and the new prediction, which is blended out."""
        self._error_time = -math.inf
        """Time at which blending began."""

    @property
    def last(self) -> Pose2D:
        """The last predicted pose, or the pose of the last report if that is newer."""
        return self._last if self._last_time >= self._time else self._pose

    def report(self, pose: Pose2D, velocity: Velocity, time: float) -> None:
        """Start a new prediction.

        Args:
            time: time of the pose and the velocity; may be before the last predicted time.
        """
        self._before, self._interval = self.velocity, time - self._time
        self._pose, self.velocity, self._time = pose, velocity, time
        self._is_new = True

    def stand(self) -> None:
        """Assume that the robot stands at the last reported pose: no further report came."""
        if self.velocity != STANDSTILL:
            self.report(self._pose, STANDSTILL, self._time)

    def can_predict(self, time: float) -> bool:
        """Return True if the pose can be predicted: the robot stands, or has reported recently."""
        return not self.velocity.moving or time - self._time <= HORIZON

    def predict(self, time: float) -> tuple[Pose2D, Velocity]:
        """Return the pose and the velocity of the robot.

        Args:
            time: time of the pose; must not be before the time of the previous call.
        """
        if self._is_new:
            self._start(time)
        pose = self._unblended(time)
        remaining = 1.0 - (time - self._error_time) / _BLEND  # share of the error
        if remaining > 0.0:
            error = self._error
            pose = Pose2D(
                pose.x + remaining * error.x,
                pose.y + remaining * error.y,
                math.remainder(pose.theta + remaining * error.theta, math.tau),
            )
        self._last_time, self._last, self._last_velocity = time, pose, self.velocity
        elapsed, velocity, acceleration = time - self._time, self.velocity, self._acceleration
        if elapsed > 0.0 and velocity.moving:
            velocity = Velocity(
                _slowed(velocity.forward, acceleration.forward, elapsed),
                _slowed(velocity.left, acceleration.left, elapsed),
                _slowed(velocity.turn, acceleration.turn, elapsed),
            )
        return pose, velocity

    def _start(self, time: float) -> None:
        """Prepare to predict from a new report; `time` is that of its first prediction."""
        self._is_new = False
        interval, now, before = self._interval, self.velocity, self._before
        if not _MIN_REPORT_INTERVAL <= interval <= _MAX_INTERVAL:
            interval, before = 1.0, now  # makes the acceleration 0: it is not known
        self._acceleration = Velocity(
            (now.forward - before.forward) / interval,
            (now.left - before.left) / interval,
            (now.turn - before.turn) / interval,
        )
        pause = time - self._last_time
        if pause < _BLEND:
            self._error = _difference(self._last, self._unblended(self._last_time))
            # This is the error at the time of the last predicted pose, so blending begins at that
            # time, but not so long ago that much of the error vanishes in the first step.
            self._error_time = max(self._last_time, time - _FIRST_STEP)
        elif pause <= _LONGEST_PAUSE:
            pose = self._unblended(time)
            self._error = _difference(self._reachable(pose, pause), pose)
            self._error_time = time
        else:  # after so long a pause, a jump is not noticed
            self._error_time = -math.inf

    def _reachable(self, pose: Pose2D, pause: float) -> Pose2D:
        """Return the pose nearest to `pose` that the robot can reach from the last predicted pose.

        The pause is the time since that pose, in seconds. Meanwhile, the robot may have stood, or
        driven at the speed before or after the pause, or at any speed between these.
        """
        forward, left, turn = pose.seen_from(self._last).arc
        before, now = self._last_velocity, self.velocity
        return self._last * Pose2D.from_arc(
            _limited(forward, before.forward, now.forward, pause),
            _limited(left, before.left, now.left, pause),
            _limited(turn, before.turn, now.turn, pause),
        )

    def _unblended(self, time: float) -> Pose2D:
        """Return the pose at a time as predicted from the last report, without blending."""
        elapsed = max(-HORIZON, min(time - self._time, HORIZON))
        velocity, acceleration = self.velocity, self._acceleration
        if elapsed > 0.0:
            if not velocity.moving:
                return self._pose
            # `from_arc` needs a constant velocity: use the mean over the elapsed time
            forward = _mean(velocity.forward, acceleration.forward, elapsed)
            left = _mean(velocity.left, acceleration.left, elapsed)
            turn = _mean(velocity.turn, acceleration.turn, elapsed)
        else:  # between the last two reports, where the velocity changed from one to the other
            # time from the last report back to the middle of the interval, so it is negative
            to_middle = max(elapsed, -self._interval) / 2
            forward = velocity.forward + acceleration.forward * to_middle
            left = velocity.left + acceleration.left * to_middle
            turn = velocity.turn + acceleration.turn * to_middle
        return self._pose * Pose2D.from_arc(forward * elapsed, left * elapsed, turn * elapsed)


def _slowed(speed: float, acceleration: float, seconds: float) -> float:
    """Return the speed after some time.

    A robot that slows down goes on slowing down to zero; any other keeps its speed.
    """
    if speed * acceleration >= 0.0:
        return speed
    slowed = speed + acceleration * seconds
    return slowed if slowed * speed > 0.0 else 0.0


def _mean(speed: float, acceleration: float, seconds: float) -> float:
    """Return the mean speed during some time; a robot that slows down may stop meanwhile."""
    if speed * acceleration >= 0.0:
        return speed
    moving = min(seconds, -speed / acceleration)
    return (speed + acceleration * moving / 2) * moving / seconds


def _limited(distance: float, before: float, now: float, seconds: float) -> float:
    """Return the distance, limited to what speeds between zero, `before` and `now` can cover."""
    return max(min(0.0, before, now) * seconds, min(max(0.0, before, now) * seconds, distance))


def _difference(one: Pose2D, other: Pose2D) -> Pose2D:
    """Return the differences of x, y and theta."""
    return Pose2D(
        one.x - other.x, one.y - other.y, math.remainder(one.theta - other.theta, math.tau)
    )


_MAX_SPEED = 3.0
"""Upper bound of the robot's speed, in m/s."""
_MAX_TURN = math.tau
"""Upper bound of the robot's angular speed, in rad/s."""
_MAX_SPEED_GAIN = 1.0
"""Maximum excess of a reported speed over the mean speed since the previous report, in m/s."""
_MAX_TURN_GAIN = 2.0
"""Maximum excess of a reported angular speed over the mean since the previous report, in rad/s."""
_MAX_DELAY = 0.3
"""Maximum delay of a report relative to the previous one, in seconds."""
_MIN_INTERVAL = 0.02
"""Lower bound of the interval by which a movement is divided, in seconds."""
_POSITION_TOLERANCE = 0.03
"""Maximum forward difference between reported pose and prediction from speeds, in metres."""
_HEADING_TOLERANCE = 0.03
"""Maximum difference between reported heading and prediction from speeds, in radians."""
_SIDEWAYS_TOLERANCE = 0.1
"""Maximum sideways movement that the speed to the left does not explain, in metres."""
POSE_SET_INTERVAL = 0.5
"""Time after the robot's pose was set in which it may still report the old pose, in seconds."""
_POSE_SET_TOLERANCE = 0.01
"""Tolerance of pose and heading within `POSE_SET_INTERVAL` for a moving robot, in m and rad."""
_POSE_SET_TOLERANCE_AT_REST = 1e-4
"""`_POSE_SET_TOLERANCE` for a standing robot."""
_MIN_SIDEWAYS = 0.004
"""Sideways movement above which the robot counts as moving sideways, in metres. Less is the
inexactness of a curve."""


class Odometry:
    """Pose of the robot in `odom`, and of `odom` in `map`.

    Attributes:
        pose: pose of the robot in `odom` at the last report; it never jumps.
        map_to_odom: pose of `odom` in `map`.
        velocity: velocity of the robot at the last report. The speed to the left is derived from
            the poses, because the reports lack it.
        time: time of the last reported pose, by the clock of `update`.
    """

    def __init__(self) -> None:
        self.pose = Pose2D()
        self.map_to_odom = Pose2D()
        self.velocity = STANDSTILL
        self.time = -math.inf
        self._reported = Pose2D()
        """Last reported pose, in `map`."""
        self._received = -math.inf
        """Time of receipt of the last report."""
        self._sideways = 0.0
        """Mean speed to the left between the last two reports, in m/s; 0 after a silence."""
        self._map_id = 0
        """Id of the map of the last reported pose."""
        self._is_comparable = False
        """True if the next report can be compared with the last one."""
        self._pose_set_until = -math.inf
        """Time until which a report may show the jump to a pose that was set."""

    def continue_from(self, pose: Pose2D) -> None:
        """Continue from a pose in `odom` after missed reports.

        The difference between the last report and the next one does not count as movement.
        """
        self._is_comparable = False
        self.pose = pose

    def pose_set(self, time: float) -> None:
        """Note that the robot's pose was set at `time`: a following report may jump."""
        self._pose_set_until = time + POSE_SET_INTERVAL

    def end_sideways_movement(self) -> None:
        """Assume that the robot does not move sideways: no report has come for a while."""
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
            False if the reported speeds are impossible: then the mean speeds since the last report
            replace them, or zeros if those are impossible, too.
        """
        moved = reported.seen_from(self._reported)
        arc, before = moved.arc, self.velocity
        interval = min(max(received - self._received, 0.0), _MAX_INTERVAL)
        possible = self._are_possible(forward, turn, arc, interval)
        if not possible:
            forward, turn = self._mean_speeds(arc, interval)
        after = Velocity(forward, 0.0, turn)
        sideways = 0.0
        if not self._is_comparable:  # there is no last report: the pose in odom stays
            self.time = received
            self.map_to_odom = reported * self.pose.inverse
        elif map_id != self._map_id or self._jumped(moved, arc, after, interval, received):
            # the robot has driven on at the reported speeds; the rest of the movement is a jump
            self.time = received
            mean_forward, mean_turn = (before.forward + forward) / 2, (before.turn + turn) / 2
            self.pose *= Pose2D.from_arc(mean_forward * interval, 0.0, mean_turn * interval)
            self.map_to_odom = reported * self.pose.inverse
            self._pose_set_until = -math.inf  # one jump is expected, and has come
        else:
            last = self.time
            self.time = report_time(received, last, arc, before, after)
            self.pose *= moved
            # If reports are rare, the robot stands, and a sideways movement is a correction of its
            # localisation.
            if abs(arc.left) > _MIN_SIDEWAYS and interval < _MAX_INTERVAL:
                sideways = arc.left / max(self.time - last, _MIN_INTERVAL)
                sideways = max(-_MAX_SPEED, min(_MAX_SPEED, sideways))
        self.velocity = Velocity(forward, self._speed_left(sideways), turn)
        self._sideways = sideways
        self._reported, self._map_id, self._received = reported, map_id, received
        self._is_comparable = True
        return possible

    def _speed_left(self, mean: float) -> float:
        """Return the speed to the left at a report, in m/s.

        Args:
            mean: mean speed to the left since the previous report, in m/s. `_sideways` is still the
                mean of the interval before that.
        """
        slows_down = abs(mean) < abs(self._sideways) and mean * self._sideways > 0.0
        if not slows_down:
            return mean
        # A mean is the speed in the middle of its interval. At a constant deceleration, half of the
        # change from mean to mean follows between the last middle and the report.
        left = mean + (mean - self._sideways) / 2
        return left if left * mean > 0.0 else 0.0

    def _are_possible(self, forward: float, turn: float, arc: Arc, interval: float) -> bool:
        """Return True if these reported speeds are possible after the robot's last movement."""
        if abs(forward) > _MAX_SPEED or abs(turn) > _MAX_TURN:
            return False
        if not self._is_comparable:
            return True
        seconds = max(interval, _MIN_INTERVAL)
        return (
            abs(forward) <= abs(arc.forward) / seconds + _MAX_SPEED_GAIN
            and abs(turn) <= abs(arc.turn) / seconds + _MAX_TURN_GAIN
        )

    def _mean_speeds(self, arc: Arc, interval: float) -> tuple[float, float]:
        """Return the mean forward and angular speed since the last report, in m/s and rad/s.

        Return zeros if the reports cannot be compared, or no robot is that fast.

        Args:
            arc: movement since the last report.
            interval: time since the last report, at most `_MAX_INTERVAL`, in seconds.
        """
        seconds = max(interval, _MIN_INTERVAL)
        forward, turn = arc.forward / seconds, arc.turn / seconds
        if not self._is_comparable or abs(forward) > _MAX_SPEED or abs(turn) > _MAX_TURN:
            return 0.0, 0.0
        return forward, turn

    def _jumped(
        self,
        moved: Pose2D,
        arc: Arc,
        after: Velocity,
        interval: float,
        received: float,
    ) -> bool:
        """Return True if the movement since the last report cannot have been driven.

        Args:
            moved: the movement, as a pose in the frame of the last report.
            arc: the same movement, as an arc at constant velocities.
            after: velocity in this report.
            interval: time between the receipts of both reports, at most `_MAX_INTERVAL`, in
                seconds.
            received: time of receipt of this report.
        """
        before = self.velocity
        forward, turn = (before.forward + after.forward) / 2, (before.turn + after.turn) / 2
        # The times of receipt are inexact, so the duration is derived from the movement: from its
        # turn if that outweighs the distance, otherwise from its distance.
        turns_mostly = abs(turn) > abs(forward) / LEVER
        speed, distance = (turn, arc.turn) if turns_mostly else (forward, arc.forward)
        duration = distance / speed if speed else 0.0
        duration = min(max(duration, 0.0), interval + _MAX_DELAY)
        error = moved.seen_from(Pose2D.from_arc(forward * duration, 0.0, turn * duration))
        # a jump is expected: tolerate less, to notice a small one
        if received <= self._pose_set_until:
            limit = _POSE_SET_TOLERANCE
            if not (before.moving or after.moving):
                limit = _POSE_SET_TOLERANCE_AT_REST
            return error.distance > limit or abs(error.theta) > limit
        # the robot may have changed its speed at any time since the last report
        forward_margin = abs(after.forward - before.forward) * interval / 2
        turn_margin = abs(after.turn - before.turn) * interval / 2
        position_tolerance = _POSITION_TOLERANCE + forward_margin
        heading_tolerance = _HEADING_TOLERANCE + turn_margin
        sideways_tolerance = _SIDEWAYS_TOLERANCE + abs(self._sideways) * interval
        # If the speed has changed, the derived duration is inexact. What was predicted from this
        # duration, i.e. the position of a robot that mostly turns, otherwise the heading, gets a
        # wider tolerance.
        if turns_mostly:
            duration_error = min(turn_margin / abs(turn), interval)
            position_tolerance += abs(forward) * duration_error
        elif forward:
            duration_error = min(forward_margin / abs(forward), interval)
            heading_tolerance += abs(turn) * duration_error
        return (
            abs(error.x) > position_tolerance
            or abs(error.theta) > heading_tolerance
            or abs(error.y) > sideways_tolerance
        )
