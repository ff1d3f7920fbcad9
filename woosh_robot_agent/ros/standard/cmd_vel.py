"""The topic cmd_vel, which drives the robot by velocities, and the service stop."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from std_srvs.srv import Trigger

from woosh_robot_agent.motion import VelocityDriver
from woosh_robot_agent.motion.timeliness import SenderClock
from woosh_robot_agent.robot.readiness import EMERGENCY_STOP
from woosh_robot_agent.robot.who_drives import Interleaving
from woosh_robot_agent.ros.bridge import Reply
from woosh_robot_agent.ros.standard.part import NO_TIME, Part, PartContext

_LOG = logging.getLogger(__name__)
_STOP_TIMEOUT = 2.0
"""Maximum wait for the answer to each request of a stop, in seconds."""


class Stop(Part):
    """The service stop: stops the robot, and cancels everything that moves it."""

    def __init__(self, context: PartContext) -> None:
        self._context = context
        context.service("stop", self._stop_requested, urgent=True)

    def _stop_requested(self, _request: Any, reply: Reply) -> None:
        # at once: commands that wait for the link thread must not be sent before the stop
        self._context.gate.announce_stop()
        self._context.thread.spawn(partial(self._stop, reply), reply.fail)

    async def _stop(self, reply: Reply) -> None:
        report = await self._context.gate.stop(_STOP_TIMEOUT)
        if not report.success:
            _LOG.error("stop: %s", report.message)
        reply.send(Trigger.Response(success=report.success, message=report.message))


NUMBER = "publication_sequence_number"
"""Key of the number that the sender gave a message, in rclpy's information about it."""
_REPORT_PERIOD = 1.0
"""Minimum time between two reports that cmd_vel has several publishers, in seconds."""


class CmdVel(Part):
    """The topic cmd_vel. Its velocities go to a `VelocityDriver`, which limits and sends them.

    Velocities are in the robot's frame (REP 103): linear.x ahead and linear.y to the left in m/s,
    angular.z counter-clockwise in rad/s. The other components are ignored.
    """

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._driver = VelocityDriver(
            context.gate, context.chassis, "cmd_vel", lambda: context.settings().velocity_limits
        )
        stamped = context.settings().cmd_vel_stamped
        context.subscribe(
            "cmd_vel",
            self._drive_stamped if stamped else self._drive,
            "geometry_msgs/TwistStamped" if stamped else "",
            with_info=True,
            urgent=True,
        )
        self._topic = context.node.resolve_topic_name("cmd_vel")
        self._publishers = Interleaving()
        """Detects several publishers by the sequence numbers of their messages."""
        self._clock = SenderClock()
        """Estimates when a velocity was published, because late ones are not sent."""
        self._reported = -math.inf
        """Monotonic time at which several publishers were last reported."""
        context.watch.interruptions.on_begin(self._driver.silence)

    async def run(self) -> None:
        await self._driver.run()

    def _drive_stamped(self, message: TwistStamped, info: Mapping[str, Any], taken: float) -> None:
        self._drive(message.twist, info, taken, stamp_objection(self._context, message))

    def _drive(
        self, velocity: Twist, info: Mapping[str, Any], taken: float, objection: str = ""
    ) -> None:
        """Pass a velocity to the driver; report several senders, at most once a second.

        With an `objection`, let the driver refuse the velocity for this reason.
        """
        number, published = info.get(NUMBER), self._clock.of_message(info, taken)
        self._driver.note_number(number)
        values = (velocity.linear.x, velocity.linear.y, velocity.angular.z)
        # a zero or a pause ends a refusal, but not while the button is pressed
        if self._context.watch.interruptions.is_pressed and any(values):
            self._driver.note_received(True, published)
            self._driver.silence(str(EMERGENCY_STOP))
        if objection:
            self._driver.refuse("age", objection, published)
            return
        self._driver.drive(*values, published)
        now = time.monotonic()
        are_several = self._publishers.observe(number, now)
        velocities = self._context.watch.velocities
        is_due = now - self._reported > _REPORT_PERIOD
        if is_due and are_several and velocities.are_driving(now):
            self._reported = now
            velocities.report(*self._publisher_names())

    def _publisher_names(self) -> list[str]:
        """Return the names of all publishers; the ROS graph does not tell which ones send."""
        publishers = self._context.node.get_publishers_info_by_topic(self._topic)
        names = sorted(f"{each.node_namespace.rstrip('/')}/{each.node_name}" for each in publishers)
        return [f"{name} (on cmd_vel)" for name in names]


def stamp_objection(context: PartContext, message: TwistStamped) -> str:
    """Return why a velocity is not sent because of its stamp; empty if it may be sent."""
    twist, stamp = message.twist, message.header.stamp
    if not any((twist.linear.x, twist.linear.y, twist.angular.z)):
        return ""  # a zero always stops the robot
    now = context.now_ns()
    # the stamp may be before 1970, which rclpy's Time refuses
    age = (now - stamp.sec * 1_000_000_000 - stamp.nanosec) / 1e9
    limit = context.settings().cmd_vel_max_age
    if not limit or abs(age) <= limit:  # 0 stands for no limit
        return ""
    if not now:
        return NO_TIME
    return (
        f"its stamp is {age:.1f} s old; cmd_vel_max_age allows {limit:g} s into the past or the "
        "future; check the sender's clock"
    )
