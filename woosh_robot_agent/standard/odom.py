"""odom and /tf: where the robot is, from the PoseSpeed that it pushes while it moves."""

from __future__ import annotations

import asyncio
import math
from typing import Any

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry as OdometryMsg

from woosh_robot_agent.link import LinkState
from woosh_robot_agent.pb.robot.robot_pack_pb2 import InitRobot, SetRobotPose, SwitchMap
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotInfo
from woosh_robot_agent.standard.host import Host, Part, every
from woosh_robot_agent.standard.odometry import Odometry
from woosh_robot_agent.standard.plane import Plane

#: s after which a robot that reports nothing does not move; it reports every 0.05 s if it does.
_SILENT_S = 0.25


class Odom(Part):
    """Publishes odom at up to `odom_rate` while the link is ready.

    A fresh push goes out at once, stamped with the time of its receipt. Between them, a robot that
    stands is repeated with the time of the moment; one that moves is not, for it is elsewhere by
    then. With `publish_tf`, `map` -> `odom` -> `base_link` goes out with each odom, with its stamp.
    """

    def __init__(self, host: Host) -> None:
        self._host = host
        self._odometry = Odometry()
        settings = host.settings()
        self._odom = host.publisher("odom") if settings.enable_odom else None
        self._tf = host.publisher("/tf") if settings.publish_tf else None
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
        async for now in every(self._rate):
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
        now = asyncio.get_running_loop().time()
        self._odometry.update(
            Plane.of(report.pose), report.twist.linear, report.twist.angular, report.map_id, now
        )
        self._received, self._known = now, True
        # a bit early counts: pushes that come at just this rate must all go out
        if self._due(now, self._passed_on, 0.7):
            self._passed_on = now
            self._publish(now)

    def _rate(self) -> float:
        return self._host.settings().odom_rate

    def _due(self, now: float, last: float, share: float) -> bool:
        """Whether it is ready, and `share` of the period has passed since `last`."""
        ready = self._known and self._host.chassis.state is LinkState.READY
        return ready and now - last >= share / self._rate()

    def _publish(self, now: float) -> None:
        self._sent = now
        stamp = self._host.now()
        if self._odom is not None:
            self._odom.publish(self._message(stamp))
        if self._tf is not None:
            self._tf.publish(self._transforms(stamp))

    def _message(self, stamp: Any) -> OdometryMsg:
        settings, odometry = self._host.settings(), self._odometry
        message = OdometryMsg()
        message.header.stamp = stamp
        message.header.frame_id = self._host.frame("odom")
        message.child_frame_id = self._host.frame("base")
        position, orientation = message.pose.pose.position, message.pose.pose.orientation
        position.x, position.y = odometry.pose.x, odometry.pose.y
        orientation.z, orientation.w = odometry.pose.quaternion
        message.pose.covariance[::7] = settings.pose_covariance
        twist = message.twist.twist
        twist.linear.x, twist.linear.y = odometry.forward, odometry.sideways
        twist.angular.z = odometry.turn
        message.twist.covariance[::7] = settings.twist_covariance
        return message

    def _transforms(self, stamp: Any) -> Any:
        frame, odometry = self._host.frame, self._odometry
        return transforms(
            stamp,
            (frame("map"), frame("odom"), odometry.map_to_odom),
            (frame("odom"), frame("base"), odometry.pose),
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
        transform.header.stamp = stamp
        transform.header.frame_id = parent
        transform.child_frame_id = child
        transform.transform.translation.x = pose.x
        transform.transform.translation.y = pose.y
        transform.transform.rotation.z, transform.transform.rotation.w = pose.quaternion
        message.transforms.append(transform)
    return message
