"""Actions that navigate: to a pose, through poses, and along waypoints."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy
from geometry_msgs.msg import PoseStamped

from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.motion import SpeedLimiter
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath
from woosh_robot_agent.pb.ros.action_pb2 import MoveBase, kExecute
from woosh_robot_agent.pb.util.common_pb2 import Pose2D as ChassisPose
from woosh_robot_agent.ros.actions.goal import Cause
from woosh_robot_agent.ros.actions.server import RejectedError
from woosh_robot_agent.ros.nav2.action import Nav2Action
from woosh_robot_agent.ros.nav2.frames import Frames
from woosh_robot_agent.ros.nav2.goals import (
    FailedCommand,
    GoalEnd,
    Nav2Context,
    Nav2Goal,
    to_duration,
)
from woosh_robot_agent.ros.nav2.slots import DrivingSlot
from woosh_robot_agent.ros.standard.part import PartContext
from woosh_robot_agent.ros.standard.poses import Pose2D, from_pose

_LOG = logging.getLogger(__name__)
_NEAR = 0.5
"""Maximum distance between the end of a path and its goal, in metres; also the distance at which a
pose on the way counts as passed."""
_FIRST_SPEED = 0.5
"""Assumed speed before the robot has driven, in m/s."""
_DRIVING = 0.05
"""Minimum speed that counts as driving, in m/s; a robot that turns on the spot is slower."""
_STEADY = 0.02
"""Maximum difference of two successive reports that counts as a steady speed, in m/s."""
_MANY = 100
"""Number of poses above which a refusal may be due to their number. The simulated robot accepts
200."""
_SMOOTHING = 0.02
"""Weight of a reported speed in the average that is the expected speed."""


async def transform_all(frames: Frames, poses: Sequence[PoseStamped]) -> None:
    """Transform the poses of a goal, in place, into the frame of the map.

    Raises:
        RejectedError: a pose is invalid, or in a frame that is not known.
    """
    for number, pose in enumerate(poses):
        try:
            await frames.to_map_frame(pose)
        except ValueError as error:
            which = f"pose {number} of {len(poses)}: " if len(poses) > 1 else ""
            raise RejectedError(f"{which}{error}") from None


def chassis_pose(message: PoseStamped) -> ChassisPose:
    """Return a pose in the frame of the map as the chassis's message."""
    pose = from_pose(message.pose)
    return ChassisPose(x=pose.x, y=pose.y, theta=pose.theta)


class Progress:
    """The poses, the distance and the time that are left of a navigation.

    The distance is measured along the path that the robot reports. If the robot reports no path to
    the goal, the distance is measured straight from pose to pose. Call the methods often while the
    robot drives: they compare its present pose with the poses and the path.

    Args:
        stops: the poses to pass, at least one, in the frame of the map; the last one is the goal.
    """

    def __init__(self, context: Nav2Context, stops: Sequence[PoseStamped]) -> None:
        self._robot_pose = context.pose
        self._last_known = context.last_known
        self._stops = [from_pose(each.pose) for each in stops]
        """The poses that are still to be passed, the goal last."""
        self._goal = self._stops[-1]
        self._speed = _FIRST_SPEED
        """Speed at which the robot is expected to drive, in m/s."""
        self._last_speed = 0.0
        """Speed in the last report, in m/s."""
        self._received = self._robot_pose.received
        """Loop time of the last report that `_speed` takes into account."""
        self._path: NavPath | None = None
        """The path that `_points` and `_distances` describe."""
        self._points = numpy.empty((0, 2))
        """Points of the path; none if it does not lead to the goal."""
        self._distances = numpy.empty(0)
        """Length of the path from each point to its end, in metres."""
        self._segment = 0
        """Index of the point of the path that the robot has passed last."""

    def stops_left(self) -> int:
        """Return the number of poses that are still to be passed."""
        while len(self._stops) > 1 and self._is_passed(self._stops[0]):
            self._stops.pop(0)
        return len(self._stops)

    def distance_and_time_left(self) -> tuple[float, float]:
        """Return the remaining distance in metres, and the expected time in seconds.

        Both are 0 while the pose of the robot is not known.
        """
        pose = self._robot_pose.pose
        if pose is None:
            return 0.0, 0.0
        if self._robot_pose.received != self._received:
            self._received = self._robot_pose.received
            self._adapt_speed(abs(self._robot_pose.velocity.forward))
        distance = self._distance_along_path(pose)
        if distance is None:  # no path to the goal was reported
            corners = [pose, *self._stops]
            distance = sum(
                math.hypot(there.x - here.x, there.y - here.y) for here, there in pairwise(corners)
            )
        return distance, distance / self._speed

    def _adapt_speed(self, speed: float) -> None:
        """Adapt the expected speed: at once to a higher reported speed, slowly to a steady one."""
        if speed > self._speed:
            self._speed = speed
        elif speed > _DRIVING and abs(speed - self._last_speed) < _STEADY:
            self._speed += _SMOOTHING * (speed - self._speed)
        self._last_speed = speed

    def _is_passed(self, stop: Pose2D) -> bool:
        pose = self._robot_pose.pose
        return pose is not None and math.hypot(stop.x - pose.x, stop.y - pose.y) < _NEAR

    def _distance_along_path(self, pose: Pose2D) -> float | None:
        """Return the length of the rest of the path, in metres; None without a path to the goal."""
        path = self._last_known.value(NavPath)
        here = numpy.array((pose.x, pose.y))
        if path is not self._path:
            self._path = path
            self._use_path(path, here)
        if len(self._points) < 2:
            return None
        along, offset = self._projected(self._segment, here)
        # go on to the next segment unless it is farther from the robot
        while self._segment < len(self._points) - 2:
            next_along, next_offset = self._projected(self._segment + 1, here)
            if next_offset > offset:
                break
            self._segment += 1
            along, offset = next_along, next_offset
        return float(self._distances[self._segment]) - along

    def _use_path(self, path: NavPath | None, here: Any) -> None:
        """Set the points and distances of a path, and the segment nearest to the robot.

        Remove the points if there is no path, or if the path does not lead to the goal.

        Args:
            path: the reported path; None without one.
            here: position of the robot in the map: an array of x and y, in metres.
        """
        poses = () if path is None else path.path.poses
        points = numpy.array([(each.x, each.y) for each in poses]).reshape(-1, 2)
        end = (self._goal.x, self._goal.y)
        is_usable = len(points) > 1 and numpy.isfinite(points).all()
        if not is_usable or math.dist(points[-1], end) >= _NEAR:
            self._points = numpy.empty((0, 2))
            return
        lengths = numpy.hypot(*numpy.diff(points, axis=0).T)
        self._points = points
        # summed from the end of the path to its start
        self._distances = numpy.append(numpy.cumsum(lengths[::-1])[::-1], 0.0)
        nearest = int(numpy.hypot(*(points - here).T).argmin())
        # the robot may be just before or behind this point, so begin with the segment before it
        self._segment = max(nearest - 1, 0)

    def _projected(self, segment: int, here: Any) -> tuple[float, float]:
        """Return how far along a segment a point is, and how far from the segment, in metres."""
        start, end = self._points[segment], self._points[segment + 1]
        length = math.dist(start, end)
        if not length:
            return 0.0, math.dist(start, here)
        along = float((here - start) @ (end - start)) / length
        along = min(max(along, 0.0), length)
        return along, math.dist(start + (end - start) * (along / length), here)


class _Navigation(Nav2Action):
    """An action whose goals are navigations of the chassis."""

    navigates = True

    def publish(self, goal: Nav2Goal, progress: Progress, **fields: Any) -> None:
        """Publish feedback on a navigation."""
        distance, time = progress.distance_and_time_left()
        goal.feedback(
            current_pose=self.context.pose.stamped,
            navigation_time=to_duration(goal.elapsed),
            estimated_time_remaining=to_duration(time),
            distance_remaining=distance,
            **fields,
        )


class NavigateToPose(_Navigation):
    """Drives to a pose."""

    name = "navigate_to_pose"

    async def check(self, request: Any) -> None:
        await transform_all(self.context.frames, [request.pose])
        self.log_unused(request, "behavior_tree")

    async def execute(self, goal: Nav2Goal) -> None:
        target = goal.request.pose
        progress = Progress(self.context, [target])
        await goal.run_command(
            MoveBase(action=kExecute, target_pose=chassis_pose(target)),
            tick=lambda: self.publish(goal, progress),
        )


def poses_in(field: Any) -> list[PoseStamped]:
    """Return the poses in a field: an array, or since Kilted a message with an array."""
    return list(getattr(field, "goals", field))


class NavigateThroughPoses(_Navigation):
    """Drives through poses, with a stop and a turn at each."""

    name = "navigate_through_poses"

    async def check(self, request: Any) -> None:
        await transform_all(self.context.frames, poses_in(request.poses))
        self.log_unused(request, "behavior_tree")

    def validate(self, request: Any) -> None:
        if not poses_in(request.poses):
            raise GoalEnd("the goal has no poses: give at least one")

    async def execute(self, goal: Nav2Goal) -> None:
        poses = poses_in(goal.request.poses)
        progress = Progress(self.context, poses)
        stops = [chassis_pose(each) for each in poses]
        command = MoveBase(
            action=kExecute,
            poses=stops,
            target_pose=stops[-1],
            execution_mode=MoveBase.kOneByOne,
        )
        try:
            await goal.run_command(command, tick=lambda: self._publish(goal, poses, progress))
        except GoalEnd as end:
            is_refused = isinstance(end, FailedCommand) and end.cause is Cause.REFUSAL
            if is_refused and len(poses) > _MANY:
                many = f"the goal has {len(poses)} poses, which may be too many: send fewer"
                end = GoalEnd(f"{end}; {many}")
            left = progress.stops_left()
            goal.result = self.action_type.Result(**self._statuses(poses, left, str(end)))
            raise end from None
        goal.result = self.action_type.Result(**self._statuses(poses, 0))

    def _publish(self, goal: Nav2Goal, poses: Sequence[PoseStamped], progress: Progress) -> None:
        left = progress.stops_left()
        statuses = self._statuses(poses, left)
        self.publish(goal, progress, number_of_poses_remaining=left, **statuses)

    def _statuses(
        self, poses: Sequence[PoseStamped], left: int, failure: str = ""
    ) -> dict[str, Any]:
        """Return the field of feedback and results with the states of the poses; {} before Kilted.

        Args:
            left: number of poses that the robot has not passed.
            failure: why it does not reach them; empty while it may reach them.
        """
        if not hasattr(self.action_type.Result, "waypoint_statuses"):
            return {}
        status = class_of("nav2_msgs/WaypointStatus")
        passed, waiting = len(poses) - left, status.FAILED if failure else status.PENDING
        statuses = [
            status(
                waypoint_status=status.COMPLETED if number < passed else waiting,
                waypoint_index=number,
                waypoint_pose=pose,
                error_msg="" if number < passed else failure,
            )
            for number, pose in enumerate(poses)
        ]
        return {"waypoint_statuses": statuses}


class FollowWaypoints(_Navigation):
    """Drives to one pose after the other. A pose that the robot cannot reach is missed."""

    name = "follow_waypoints"

    async def check(self, request: Any) -> None:
        await transform_all(self.context.frames, request.poses)

    def validate(self, request: Any) -> None:
        first, count = _first_waypoint(request), len(request.poses)
        if first >= count:
            raise GoalEnd(
                f"there is no waypoint {first}: the goal has {count}", "NO_VALID_WAYPOINTS"
            )

    async def execute(self, goal: Nav2Goal) -> None:
        poses, first = goal.request.poses, _first_waypoint(goal.request)
        cause: Cause | None = None  # who decided that the waypoint before was reached
        for loop in range(getattr(goal.request, "number_of_loops", 0) + 1):
            for number in range(0 if loop else first, len(poses)):
                if cause is Cause.LATE_REPORT:
                    before = (number - 1) % len(poses)  # perhaps the last one of the loop before
                    raise GoalEnd(
                        f"the robot reached waypoint {before} while the link was lost, and what "
                        "happened since is not known: send the remaining waypoints again"
                    )
                cause = await self._visit(goal, number, poses[number])

    async def _visit(self, goal: Nav2Goal, number: int, pose: PoseStamped) -> Cause | None:
        """Drive to a waypoint; return who decided that it is reached, None if it is missed."""
        try:
            return await goal.run_command(
                MoveBase(action=kExecute, target_pose=chassis_pose(pose)),
                tick=lambda: goal.feedback(current_waypoint=number),
            )
        except FailedCommand as failure:
            if goal.is_ending or not _says_unreachable(failure):
                raise
            _LOG.warning("%s: waypoint %d is missed: %s", self.name, number, failure)
            goal.result.missed_waypoints.append(_missed(goal.result, number, pose, str(failure)))
            return None


def _first_waypoint(request: Any) -> int:
    return int(getattr(request, "goal_index", 0))  # Humble lacks it, and number_of_loops


_POSE_CODES = frozenset((13010100001, 13010100002, 13010100005))
"""Status codes for a pose that is occupied or out of reach, without the last digit: that is the
level, which differs between robots."""
_POSE_WORDS = ("no free path", "no path", "keep-out area", "too winding to plan")
"""Parts of a report's text that mean the same, in lower case."""


def _says_unreachable(failure: FailedCommand) -> bool:
    """Return True if the report that ended a drive says that the pose cannot be reached.

    Only the report that ended the drive is considered, not the present state of the robot: an
    emergency stop may be over when the report arrives. In doubt, return False, so that the robot
    does not drive on to another pose.
    """
    if failure.cause is not Cause.REPORT:
        return False
    text = str(failure).lower()
    return failure.status_code // 10 in _POSE_CODES or any(words in text for words in _POSE_WORDS)


def _missed(result: Any, number: int, pose: PoseStamped, reason: str) -> Any:
    """Return an entry of `missed_waypoints`: a number on Humble, later a message."""
    # the type of the field is `sequence<...>`
    element = result.get_fields_and_field_types()["missed_waypoints"].partition("<")[2][:-1]
    if element == "int32":
        return number
    message = class_of(element)
    if hasattr(message, "waypoint_status"):
        return message(
            waypoint_status=message.FAILED,
            waypoint_index=number,
            waypoint_pose=pose,
            error_msg=reason,
        )
    return message(index=number, goal=pose)


_HIGHEST_SPEED = 1.0
"""Speed from which a limit counts as none, in m/s, unless `cmd_vel_max_linear` is higher. The robot
does not report its own maximum speed."""


class SpeedLimit:
    """The topic speed_limit: limits the speed of all navigations, whoever starts them.

    The robot takes a limit as its speed. So a limit that does not restrict it is not sent, because
    it might make the robot faster. A navigation of Nav2's actions whose limit the robot refuses is
    aborted.

    Args:
        driving: holds the goal that moves the robot.
    """

    def __init__(self, robot: PartContext, driving: DrivingSlot) -> None:
        self._robot = robot
        self._driving = driving
        self._log = LogOnce(_LOG)
        self._message: Any = None
        """The last message with a valid value; None before the first."""
        self._limiter = SpeedLimiter(
            robot.chassis,
            robot.gate,
            lambda work: asyncio.get_running_loop().create_task(work, name="nav2: speed limit"),
            self._refused,
        )
        robot.subscribe("speed_limit", self._received)

    def settings_changed(self) -> None:
        """Limit the speed anew: a percentage refers to `cmd_vel_max_linear`."""
        if self._message is not None:
            self._received(self._message)

    def _received(self, message: Any) -> None:
        """Set a limit in m/s, or in percent of `cmd_vel_max_linear`; 0 stands for no limit."""
        value = message.speed_limit
        if not 0.0 <= value < math.inf:
            self._log.warn("value", f"speed_limit is ignored, because it is {value:g}")
            return
        self._message = message
        max_linear = self._robot.settings().velocity_limits.max_linear
        if message.percentage:
            limit = value / 100.0 * max_linear if value < 100.0 else math.inf
        else:
            limit = value if value < max(max_linear, _HIGHEST_SPEED) else math.inf
        if value and not limit:
            text = "speed_limit is ignored: it is a percentage of cmd_vel_max_linear, which is 0"
            self._log.warn("value", text)
            return
        self._log.clear()
        self._limiter.limit(limit or math.inf)

    def _refused(self, reason: str) -> None:
        advice = "publish a higher one on speed_limit, or 0 for none"
        if not self._driving.stop(GoalEnd(f"{reason}; {advice}")):
            _LOG.warning("speed_limit: %s", reason)
