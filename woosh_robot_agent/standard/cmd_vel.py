"""cmd_vel: drives the robot while somebody asks for it, and stops it when nobody does any more."""

from __future__ import annotations

import asyncio
import logging
import math
from typing import Any

from geometry_msgs.msg import Twist as TwistMsg
from geometry_msgs.msg import TwistStamped
from rclpy.time import Time

from woosh_robot_agent.link import LinkError, LinkState, SupersededError
from woosh_robot_agent.link.once import LogOnce
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.standard.host import Host

_LOG = logging.getLogger(__name__)


class CmdVel:
    """The driver of the robot on behalf of cmd_vel.

    Velocities are in the robot's frame (REP 103): linear.x ahead and linear.y to the left in m/s,
    angular.z counter-clockwise in rad/s; the rest is ignored, as a robot on wheels can do no more.
    Every one is sent at most once. A refused one counts as none.

    Attributes:
        driving: whether the last velocity that was sent was not zero.
    """

    def __init__(self, host: Host) -> None:
        self._host = host
        self.driving = False
        self._log = LogOnce(_LOG)
        self._waiting: Twist | None = None
        self._heard = -math.inf
        self._obeyed = -math.inf
        self._sent = -math.inf
        self._silenced = False
        self._wake = asyncio.Event()
        self._requests: set[asyncio.Task[None]] = set()
        stamped = host.settings().cmd_vel_stamped
        host.subscribe(
            "cmd_vel",
            self._stamped if stamped else self._asked,
            "geometry_msgs/TwistStamped" if stamped else "",
        )
        host.chassis.on_state(self._link_changed)

    async def run(self) -> None:
        """See `Part.run`: send the newest velocity when its time has come, and the last zero."""
        loop = asyncio.get_running_loop()
        while True:
            due = self._due()
            if due <= loop.time():
                self._send_due()
                continue
            self._wake.clear()
            timer = loop.call_at(due, self._wake.set) if due < math.inf else None
            try:
                await self._wake.wait()
            finally:
                if timer is not None:
                    timer.cancel()

    def silence(self) -> None:
        """Obey no more until whoever sends velocities pauses or asks for a stop."""
        self._silenced = True
        self._waiting = None
        self.driving = False
        self._wake.set()

    def _stamped(self, message: TwistStamped) -> None:
        age = self._age(message.header.stamp)
        limit = self._host.settings().cmd_vel_max_age
        if limit and age > limit:
            self._refuse(
                "age",
                f"its stamp is {age:.1f} s old, and more than cmd_vel_max_age ({limit:g} s) is "
                "refused; check the sender's clock",
            )
            return
        self._asked(message.twist)

    def _age(self, stamp: Any) -> float:
        now = self._host.node.get_clock().now()
        return float((now - Time.from_msg(stamp, clock_type=now.clock_type)).nanoseconds) / 1e9

    def _asked(self, message: TwistMsg) -> None:
        values = (message.linear.x, message.linear.y, message.angular.z)
        if not all(map(math.isfinite, values)):
            self._refuse("finite", f"{values} are not all finite numbers")
            return
        now = asyncio.get_running_loop().time()
        settings = self._host.settings()
        paused = now - self._heard > settings.cmd_vel_timeout
        self._heard = now
        if self._silenced and any(values) and not paused:
            self._refuse("silenced", "the robot was stopped; pause or send a zero first")
            return
        self._silenced = False
        if any(values) and not settings.cmd_vel_override and self._host.actions.running_goals:
            self._refuse(
                "goal",
                "a goal is running: cancel it first, or set the parameter cmd_vel_override",
            )
            return
        if self._host.chassis.state is not LinkState.READY:
            self._refuse("link", "there is no link to the chassis")
            return
        self._log.clear()
        self._obeyed = now
        self._waiting = self._clamped(*values)
        self._wake.set()

    def _refuse(self, kind: str, reason: str) -> None:
        self._log.warn(kind, f"cmd_vel is not obeyed: {reason}")

    def _clamped(self, linear: float, aside: float, angular: float) -> Twist:
        settings = self._host.settings()
        speed = math.hypot(linear, aside)
        most = settings.cmd_vel_max_linear
        scale = most / speed if speed > most else 1.0
        limit = settings.cmd_vel_max_angular
        return Twist(
            linear=linear * scale,
            linear_y=aside * scale,
            angular=max(-limit, min(limit, angular)),
        )

    def _due(self) -> float:
        """When something is to be sent, in the loop's time."""
        settings = self._host.settings()
        if self._waiting is not None:
            stop = not any(value for _, value in self._waiting.ListFields())
            # a stop waits for nothing
            return 0.0 if stop else self._sent + 1.0 / settings.cmd_vel_rate
        if self.driving and self._host.chassis.state is LinkState.READY:
            return self._obeyed + settings.cmd_vel_timeout
        return math.inf

    def _send_due(self) -> None:
        if self._waiting is not None:
            self._send(self._waiting)
        elif self._host.chassis.driving:
            self._send(Twist())
        else:  # a task or an action has had the wheels since: a zero would stop that
            self.driving = False

    def _send(self, command: Twist) -> None:
        self._waiting = None
        self._sent = asyncio.get_running_loop().time()
        self.driving = any(value for _, value in command.ListFields())
        task = asyncio.get_running_loop().create_task(self._request(command), name="cmd_vel")
        self._requests.add(task)
        task.add_done_callback(self._requests.discard)

    async def _request(self, command: Twist) -> None:
        try:
            answer = await self._host.chassis.request(self._host.requests.address(command))
        except SupersededError as error:  # everyday business while the chassis is slow
            _LOG.debug("cmd_vel: %s", error)
        except LinkError as error:
            self._log.warn("request", f"cmd_vel did not get through: {error}")
        else:
            if not answer.ok:
                self._log.warn("refused", f"the chassis refused cmd_vel: {answer.msg}")

    def _link_changed(self, state: LinkState) -> None:
        if state is LinkState.READY:  # if it was driving when the link went, it gets its zero now
            self._wake.set()
        else:
            self._waiting = None
