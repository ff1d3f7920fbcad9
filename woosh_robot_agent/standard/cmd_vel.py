"""cmd_vel: drives the robot by a stream of velocities."""

from __future__ import annotations

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.time import Time

from woosh_robot_agent.motion import VelocityDriver, VelocityLimits
from woosh_robot_agent.standard.part import Part
from woosh_robot_agent.standard.part_context import PartContext


class CmdVel(Part):
    """The topic cmd_vel; the rules for its velocities are those of `VelocityDriver`.

    Velocities are in the robot's frame (REP 103): linear.x ahead and linear.y to the left in m/s,
    angular.z counter-clockwise in rad/s. The other components are ignored.
    """

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._driver = VelocityDriver(
            context.gate,
            context.chassis,
            "cmd_vel",
            self._limits,
            log_refusals=False,  # the log of all refused commands has them, with their reasons
        )
        stamped = context.settings().cmd_vel_stamped
        context.subscribe(
            "cmd_vel",
            self._stamped if stamped else self._drive,
            "geometry_msgs/TwistStamped" if stamped else "",
        )

    async def run(self) -> None:
        await self._driver.run()

    def _limits(self) -> VelocityLimits:
        settings = self._context.settings()
        return VelocityLimits(
            max_linear=settings.cmd_vel_max_linear,
            max_angular=settings.cmd_vel_max_angular,
            rate=settings.cmd_vel_rate,
            timeout=settings.cmd_vel_timeout,
            override=settings.cmd_vel_override,
        )

    def _stamped(self, message: TwistStamped) -> None:
        now = self._context.node.get_clock().now()
        stamp = Time.from_msg(message.header.stamp, clock_type=now.clock_type)
        age = float((now - stamp).nanoseconds) / 1e9
        limit = self._context.settings().cmd_vel_max_age
        if limit and abs(age) > limit:
            self._driver.refuse(
                "age",
                f"its stamp is {age:.1f} s old; cmd_vel_max_age allows {limit:g} s into the past "
                "or the future; check the sender's clock",
            )
            return
        self._drive(message.twist)

    def _drive(self, velocity: Twist) -> None:
        self._driver.drive(velocity.linear.x, velocity.linear.y, velocity.angular.z)
