"""The robot's pose in the map, and the topic amcl_pose."""

from __future__ import annotations

import asyncio
import logging
import math

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped

from woosh_robot_agent.link import Answer, LinkError, LinkState
from woosh_robot_agent.pb.robot.robot_pack_pb2 import InitRobot, SetRobotPose, SwitchMap
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotInfo
from woosh_robot_agent.ros.standard.odometry import POSE_SET_INTERVAL
from woosh_robot_agent.ros.standard.part import PartContext
from woosh_robot_agent.ros.standard.poses import Pose2D, Velocity, check_finite, to_pose

_LOG = logging.getLogger(__name__)
_MIN_DISTANCE = 0.25
"""Distance after which amcl_pose is published again, in metres; amcl's default."""
_MIN_TURN = 0.2
"""Angle after which amcl_pose is published again, in radians; amcl's default."""
_SILENCE = 1.0
"""Time without a report after which the robot counts as standing, in seconds. A moving robot
reports at 5 Hz."""
_MAX_WAIT = 3.0
"""Maximum wait until the robot stands, in seconds. Real robots stand 0.9 s after a stop."""
_CHECK_PERIOD = 0.05
"""Period of the checks whether the robot stands, in seconds."""


class RobotPose:
    """The robot's pose in its last report. Publishes amcl_pose. Used in the link thread.

    Attributes:
        pose: the pose in the map; None while the pose is not known.
        velocity: the velocity in the robot's frame. The sideways speed is derived from the last two
            poses, because the robot does not report it.
        received: loop time of the last report.
    """

    def __init__(self, context: PartContext) -> None:
        self.pose: Pose2D | None = None
        self.velocity = Velocity()
        self.received = -math.inf
        self._context = context
        self._settled = -math.inf
        """Loop time until which the robot may still report the pose before one that was set."""
        self._published: Pose2D | None = None
        """The pose that was published last; None to publish the next pose in any case."""
        self._publisher = context.publisher("amcl_pose")
        chassis = context.chassis
        chassis.on_snapshot(self._snapshot)
        chassis.on_state(self._link_changed)
        chassis.subscribe(PoseSpeed, self._reported)
        for request in (InitRobot, SetRobotPose, SwitchMap):
            chassis.on_accepted(request, self._pose_set)

    @property
    def stamped(self) -> PoseStamped:
        """The pose as a message with the current time; the origin while the pose is not known."""
        message = PoseStamped(header=self._context.header("map"))
        if self.pose is not None:
            message.pose = to_pose(self.pose)
        return message

    async def wait_until_standing(self) -> None:
        """Wait until the robot stands, or sends no report for `_SILENCE`; at most `_MAX_WAIT`."""
        clock = asyncio.get_running_loop().time
        started = now = clock()
        while self.velocity.moving:
            is_silent = now - max(self.received, started) >= _SILENCE  # silence since the call
            if is_silent or now - started >= _MAX_WAIT:
                return
            await asyncio.sleep(_CHECK_PERIOD)
            now = clock()

    def _snapshot(self, info: RobotInfo) -> None:
        if info.HasField("pose_speed"):
            self._reported(info.pose_speed)

    def _link_changed(self, state: LinkState) -> None:
        if state is not LinkState.READY:
            self.pose = None

    def _reported(self, report: PoseSpeed) -> None:
        try:
            pose = Pose2D.from_message(report.pose)
            check_finite("speed", report.twist.linear, report.twist.angular)
        except ValueError:  # the part `odom` of the standard layer counts and logs it
            return
        now = asyncio.get_running_loop().time()
        to_the_left = 0.0  # until there are two poses
        if self.pose is not None and now > self.received:
            to_the_left = pose.seen_from(self.pose).arc.left / (now - self.received)
        self.pose = pose
        self.velocity = Velocity(report.twist.linear, to_the_left, report.twist.angular)
        self.received = now
        if self._published is not None and now > self._settled:
            moved = pose.seen_from(self._published)
            if moved.distance < _MIN_DISTANCE and abs(moved.theta) < _MIN_TURN:
                return
        self._publish(pose)

    def _pose_set(self) -> None:
        """Request the pose: a robot that stands does not report a pose that was set."""
        self._published = None
        self._settled = asyncio.get_running_loop().time() + POSE_SET_INTERVAL
        self._context.thread.spawn(self._request_pose)

    async def _request_pose(self) -> None:
        robot = self._context
        try:
            await robot.chassis.request(robot.requests.empty(PoseSpeed), tap=self._answered)
        except LinkError as error:
            _LOG.debug("cannot ask for the pose: %s", error)

    def _answered(self, answer: Answer) -> None:
        if answer.ok and isinstance(answer.body, PoseSpeed):
            self._reported(answer.body)

    def _publish(self, pose: Pose2D) -> None:
        self._published = pose
        message = PoseWithCovarianceStamped(header=self._context.header("map"))
        message.pose.pose = to_pose(pose)
        # every seventh element is on the diagonal of the 6x6 matrix
        message.pose.covariance[::7] = self._context.settings().pose_covariance
        self._publisher.publish(message)
