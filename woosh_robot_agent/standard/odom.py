"""odom and /tf: where the robot is, from the PoseSpeed that it pushes while it moves."""

from __future__ import annotations

import asyncio
import logging
import math
from typing import Any

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry as OdometryMsg

from woosh_robot_agent.link import LinkState
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.pb.robot.robot_pack_pb2 import InitRobot, SetRobotPose, SwitchMap
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotInfo
from woosh_robot_agent.standard.audience import Audience
from woosh_robot_agent.standard.odometry import Odometry
from woosh_robot_agent.standard.part_context import Part, PartContext
from woosh_robot_agent.standard.plane import Plane
from woosh_robot_agent.standard.settings import StandardSettings

_LOG = logging.getLogger(__name__)
#: s after which a robot that reports nothing does not move; it reports every 0.05 s if it does.
_SILENT_S = 0.25


class Odom(Part):
    """Publishes odom at up to `odom_rate` while the link is ready and somebody subscribes.

    A fresh push goes out at once, stamped with the time of its receipt. Between them, a robot that
    stands is repeated with the time of the moment; one that moves is not, for it is elsewhere by
    then. With `publish_tf`, `map` -> `odom` -> `base_link` goes out with each odom, with its stamp.
    """

    def __init__(self, host: PartContext) -> None:
        self._host = host
        self._odometry = Odometry()
        self._log = LogOnce(_LOG)
        settings = host.settings()
        self._audience = Audience(host)
        self._odom = self._audience.publisher("odom") if settings.enable_odom else None
        self._tf = self._audience.publisher("/tf") if settings.publish_tf else None
        # each is made once and sent again and again: making one takes longer than sending it
        self._message = OdometryMsg(child_frame_id=host.frame("base"))
        self._message.header.frame_id = host.frame("odom")
        self._filled_by: StandardSettings | None = None
        self._transforms: Any = self._chain() if settings.publish_tf else None
        self._received = -math.inf
        self._passed_on = -math.inf
        self._sent = -math.inf
        self._known = False
        host.chassis.on_snapshot(self._snapshot)
        host.chassis.on_state(self._link_changed)
        for placing in (InitRobot, SetRobotPose, SwitchMap):
            host.chassis.on_accepted(placing, self._placed)
        host.chassis.subscribe(PoseSpeed, self._pushed)

    async def run(self) -> None:
        """See `Part.run`: what is published while nothing is pushed."""
        async for now in self._audience.times(self._rate):
            if now - self._received > _SILENT_S:
                self._odometry.silent()
            if not self._odometry.moving and self._due(now, self._sent, 0.9):
                self._publish(now)

    def _snapshot(self, info: RobotInfo) -> None:
        if info.HasField("pose_speed"):
            self._odometry.lost()  # who knows what happened while there was no link
            self._pushed(info.pose_speed)

    def _link_changed(self, state: LinkState) -> None:
        if state is not LinkState.READY:
            self._known = False

    def _placed(self) -> None:
        self._odometry.placed(asyncio.get_running_loop().time())

    def _pushed(self, report: PoseSpeed) -> None:
        pose, twist = report.pose, report.twist
        numbers = (pose.x, pose.y, pose.theta, twist.linear, twist.angular)
        if not all(map(math.isfinite, numbers)):  # one would stay in all that is added to it
            self._log.warn("not finite", f"skipped a PoseSpeed that is no pose for odom: {numbers}")
            return
        self._log.clear()
        now = asyncio.get_running_loop().time()
        self._odometry.update(Plane.of(pose), twist.linear, twist.angular, report.map_id, now)
        self._received, self._known = now, True
        # a bit early counts: pushes that come at just this rate must all go out
        if self._due(now, self._passed_on, 0.7):
            self._passed_on = now
            self._publish(now)

    def _rate(self) -> float:
        return self._host.settings().odom_rate

    def _due(self, now: float, last: float, share: float) -> bool:
        """Whether `share` of the period has passed since `last`, and it can and need be."""
        if now - last < share / self._rate():
            return False
        ready = self._known and self._host.chassis.state is LinkState.READY
        return ready and self._audience.present

    def _publish(self, now: float) -> None:
        self._sent = now
        stamp = self._host.now()
        if self._odom is not None and self._odom.get_subscription_count():
            self._odom.publish(self._filled(stamp))
        if self._tf is not None and self._tf.get_subscription_count():
            to_odom, to_base = self._transforms.transforms
            _place(to_odom, stamp, self._odometry.map_to_odom)
            _place(to_base, stamp, self._odometry.pose)
            self._tf.publish(self._transforms)

    def _filled(self, stamp: Any) -> OdometryMsg:
        """The message, as things are now."""
        settings, odometry, message = self._host.settings(), self._odometry, self._message
        if settings is not self._filled_by:
            self._filled_by = settings
            message.pose.covariance[::7] = settings.pose_covariance
            message.twist.covariance[::7] = settings.twist_covariance
        message.header.stamp = stamp
        position, orientation = message.pose.pose.position, message.pose.pose.orientation
        position.x, position.y = odometry.pose.x, odometry.pose.y
        orientation.z, orientation.w = odometry.pose.quaternion
        twist = message.twist.twist
        twist.linear.x, twist.linear.y = odometry.forward, odometry.sideways
        twist.angular.z = odometry.turn
        return message

    def _chain(self) -> Any:
        frame = self._host.frame
        return transforms(
            self._host.now(),
            (frame("map"), frame("odom"), Plane()),
            (frame("odom"), frame("base"), Plane()),
        )


def transforms(stamp: Any, *chain: tuple[str, str, Plane]) -> Any:
    """A TFMessage.

    Args:
        stamp: time of all of them.
        chain: parent frame, child frame, and the child's pose in the parent.
    """
    from tf2_msgs.msg import TFMessage  # not everybody who leaves /tf to others has it

    message = TFMessage()
    for parent, child, pose in chain:
        transform = TransformStamped()
        transform.header.frame_id = parent
        transform.child_frame_id = child
        _place(transform, stamp, pose)
        message.transforms.append(transform)
    return message


def _place(transform: TransformStamped, stamp: Any, pose: Plane) -> None:
    transform.header.stamp = stamp
    shift, rotation = transform.transform.translation, transform.transform.rotation
    shift.x, shift.y = pose.x, pose.y
    rotation.z, rotation.w = pose.quaternion
