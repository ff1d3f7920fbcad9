"""The topics odom and /tf, from the PoseSpeed that the robot pushes while it moves."""

from __future__ import annotations

import asyncio
import math
from itertools import pairwise
from typing import Any

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry as OdometryMsg

from woosh_robot_agent.link import LinkState
from woosh_robot_agent.parameters import StandardSettings
from woosh_robot_agent.pb.robot.robot_pack_pb2 import InitRobot, SetRobotPose, SwitchMap
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotInfo
from woosh_robot_agent.ros.standard.odometry import HORIZON, Odometry, Prediction
from woosh_robot_agent.ros.standard.part import Part, PartContext
from woosh_robot_agent.ros.standard.poses import Pose2D, Velocity, check_finite

_SILENCE = HORIZON
"""Time without a report after which the robot counts as not moving sideways, in seconds."""
_STANDSTILL = 1.0
"""Time without a report after which the robot counts as standing, in seconds."""


class Odom(Part):
    """Publishes odom while the link is ready and there are subscribers.

    With `odom_prediction`, odom is published at `odom_rate`: the pose of a moving robot is
    predicted from its last report, the pose of a standing robot is repeated. odom pauses if a
    moving robot has not reported for 0.3 s. After a second without a report the robot counts as
    standing, because a real robot reports only while it moves.

    Without `odom_prediction`, each report is published once, at up to `odom_rate`, and the pose of
    a standing robot is repeated. With `publish_tf`, `map` -> `odom` -> `base_link` is published
    with each message. The stamp is always the current time.
    """

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._odometry = Odometry()
        self._prediction = Prediction()
        settings = context.settings()
        self._subscribers = context.subscribers()
        self._odom = (
            context.publisher("odom", self._subscribers) if settings.enables("odom") else None
        )
        self._tf = context.publisher("/tf", self._subscribers) if settings.publish_tf else None
        # created once and reused: creating a message takes longer than publishing it
        self._message = OdometryMsg(child_frame_id=context.frame("base"))
        self._message.header.frame_id = context.frame("odom")
        self._covariances_of: StandardSettings | None = None
        """Settings whose covariances are in `_message`."""
        self._transforms: Any = None
        """The TFMessage for /tf, reused for each message."""
        if settings.publish_tf:
            frames = tuple(map(context.frame, ("map", "odom", "base")))
            chain = [(*pair, Pose2D()) for pair in pairwise(frames)]
            self._transforms = transforms(context.now(), *chain)
        self._received = -math.inf
        """Loop time of the last usable report."""
        self._last_forwarded = -math.inf
        """Loop time of the last push that was published without a prediction."""
        self._last_sent = -math.inf
        """Loop time of the last message."""
        self._is_pose_known = False
        """True if the robot has reported its pose since the link became ready."""
        context.chassis.on_snapshot(self._snapshot)
        context.chassis.on_state(self._link_changed)
        for request in (InitRobot, SetRobotPose, SwitchMap):
            context.chassis.on_accepted(request, self._pose_set)
        context.chassis.subscribe(PoseSpeed, self._pushed)

    @property
    def map_to_odom(self) -> Pose2D | None:
        """Pose of the frame of the odometry in the map; None if it is unknown."""
        return self._odometry.map_to_odom if self._is_pose_known else None

    async def run(self) -> None:
        await self._subscribers.repeat(self._rate, self._publish_due)

    async def _publish_due(self, now: float) -> None:
        self._note_silence(now - self._received)
        if self._context.settings().odom_prediction:
            # 0.5: skip a message that would follow right after another message
            if self._prediction.can_predict(now) and self._is_due(now, self._last_sent, 0.5):
                self._publish_predicted()
        # 0.9 tolerates jitter of this timer
        elif not self._prediction.velocity.moving and self._is_due(now, self._last_sent, 0.9):
            self._publish_reported(now)

    def _snapshot(self, info: RobotInfo) -> None:
        if info.HasField("pose_speed"):
            # the robot may have moved while there was no link, but its pose in `odom` must not jump
            self._odometry.continue_from(self._prediction.last)
            self._pushed(info.pose_speed)

    def _link_changed(self, state: LinkState) -> None:
        if state is not LinkState.READY:
            self._is_pose_known = False

    def _pose_set(self) -> None:
        self._odometry.pose_set(asyncio.get_running_loop().time())

    def _pushed(self, report: PoseSpeed) -> None:
        twist = report.twist
        try:  # a single NaN or infinity would make all later poses non-finite
            pose = Pose2D.from_message(report.pose)
            check_finite("speed", twist.linear, twist.angular)
        except ValueError as error:
            self._context.chassis.count_bad_value(PoseSpeed, str(error))
            return
        now = asyncio.get_running_loop().time()
        odometry = self._odometry
        if not odometry.update(pose, twist.linear, twist.angular, report.map_id, now):
            self._context.chassis.count_bad_value(
                PoseSpeed,
                f"speeds are ignored, because the robot cannot have them: linear {twist.linear:g} "
                f"m/s, angular {twist.angular:g} rad/s; odom takes them from the poses",
            )
        self._prediction.report(odometry.pose, odometry.velocity, odometry.time)
        self._received, self._is_pose_known = now, True
        predicts = self._context.settings().odom_prediction
        # 0.7 tolerates jitter: reports that arrive at exactly `odom_rate` must all be published
        if not predicts and self._is_due(now, self._last_forwarded, 0.7):
            self._last_forwarded = now
            self._publish_reported(now)

    def _note_silence(self, seconds: float) -> None:
        """Conclude from the time without a report that the robot stands."""
        odometry = self._odometry
        if seconds > _SILENCE and odometry.velocity.left:
            odometry.end_sideways_movement()
            if not odometry.velocity.moving:  # it moved sideways only
                self._prediction.stand()
        if seconds > _STANDSTILL:
            self._prediction.stand()

    def _rate(self) -> float:
        return self._context.settings().odom_rate

    def _is_due(self, now: float, last: float, share: float) -> bool:
        """Return True if `share` of the period has passed since `last`, and odom may be sent."""
        if now - last < share / self._rate():
            return False
        ready = self._is_pose_known and self._context.chassis.state is LinkState.READY
        return ready and self._subscribers.present

    def _publish_predicted(self) -> None:
        # the stamp is taken together with the time of the prediction
        now, stamp = asyncio.get_running_loop().time(), self._context.now()
        self._publish(now, stamp, *self._prediction.predict(now))

    def _publish_reported(self, now: float) -> None:
        self._publish(now, self._context.now(), self._odometry.pose, self._prediction.velocity)

    def _publish(self, now: float, stamp: Any, pose: Pose2D, velocity: Velocity) -> None:
        self._last_sent = now
        if self._odom is not None and self._odom.get_subscription_count():
            self._odom.publish(self._fill_message(stamp, pose, velocity))
        if self._tf is not None and self._tf.get_subscription_count():
            to_odom, to_base = self._transforms.transforms
            _set_transform(to_odom, stamp, self._odometry.map_to_odom)
            _set_transform(to_base, stamp, pose)
            self._tf.publish(self._transforms)

    def _fill_message(self, stamp: Any, pose: Pose2D, velocity: Velocity) -> OdometryMsg:
        """Set the values in the reused `_message`, and return it."""
        settings, message = self._context.settings(), self._message
        if settings is not self._covariances_of:
            self._covariances_of = settings
            # every seventh element is on the diagonal of the 6x6 matrix
            message.pose.covariance[::7] = settings.pose_covariance
            message.twist.covariance[::7] = settings.twist_covariance
        message.header.stamp = stamp
        position, orientation = message.pose.pose.position, message.pose.pose.orientation
        position.x, position.y = pose.x, pose.y
        orientation.z, orientation.w = pose.quaternion
        twist = message.twist.twist
        twist.linear.x, twist.linear.y = velocity.forward, velocity.left
        twist.angular.z = velocity.turn
        return message


def transforms(stamp: Any, *chain: tuple[str, str, Pose2D]) -> Any:
    """Return a TFMessage.

    Args:
        stamp: time of all transforms.
        chain: for each transform the parent frame, the child frame, and the child's pose in the
            parent.
    """
    from tf2_msgs.msg import TFMessage  # not needed, and perhaps not installed, without publish_tf

    message = TFMessage()
    for parent, child, pose in chain:
        transform = TransformStamped()
        transform.header.frame_id = parent
        transform.child_frame_id = child
        _set_transform(transform, stamp, pose)
        message.transforms.append(transform)
    return message


def _set_transform(transform: TransformStamped, stamp: Any, pose: Pose2D) -> None:
    transform.header.stamp = stamp
    shift, rotation = transform.transform.translation, transform.transform.rotation
    shift.x, shift.y = pose.x, pose.y
    rotation.z, rotation.w = pose.quaternion
