"""cmd_vel: drives the robot while somebody asks for it, and stops it when nobody does any more."""

from __future__ import annotations

import asyncio
import logging
import math

from geometry_msgs.msg import Twist as TwistMsg
from geometry_msgs.msg import TwistStamped
from rclpy.time import Time

from woosh_robot_agent.link import LinkError, LinkState, SupersededError
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.standard.part import Part
from woosh_robot_agent.standard.part_context import PartContext
from woosh_robot_agent.standard.wheels import Wheels

_LOG = logging.getLogger(__name__)
_PAUSE_S = 2.0
"""s without any message after which whoever sends velocities has let go."""


class CmdVel(Part):
    """The driver of the robot on behalf of cmd_vel.

    Velocities are in the robot's frame (REP 103): linear.x ahead and linear.y to the left in m/s,
    angular.z counter-clockwise in rad/s; the rest is ignored, as a robot on wheels can do no more.
    Every one is sent at most once. A refused one counts as none.

    Attributes:
        driving: whether the last velocity that was sent was not zero.
    """

    def __init__(self, host: PartContext) -> None:
        self._host = host
        self.driving = False
        self._log = LogOnce(_LOG)
        self._waiting: Twist | None = None
        self._heard = -math.inf
        self._obeyed = -math.inf
        self._sent = -math.inf
        self._silenced = False
        self._owes_zero = False
        self._wheels = Wheels(host.chassis)
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
        now = self._host.node.get_clock().now()
        stamp = Time.from_msg(message.header.stamp, clock_type=now.clock_type)
        age = float((now - stamp).nanoseconds) / 1e9
        limit = self._host.settings().cmd_vel_max_age
        if limit and abs(age) > limit:
            self._refuse(
                "age",
                f"its stamp is {age:.1f} s old, and more than cmd_vel_max_age ({limit:g} s) "
                "either way is refused; check the sender's clock",
            )
            return
        self._asked(message.twist)

    def _asked(self, message: TwistMsg) -> None:
        values = (message.linear.x, message.linear.y, message.angular.z)
        if not all(map(math.isfinite, values)):
            self._refuse("finite", f"{values} are not all finite numbers")
            return
        now = asyncio.get_running_loop().time()
        paused, self._heard = now - self._heard > _PAUSE_S, now
        moves = any(values)
        self._silenced = self._silenced and moves and not paused
        reason = self._objection() if moves else ("", "")
        if reason[0]:
            self._refuse(*reason)
        elif self._host.chassis.state is not LinkState.READY:
            self._refuse("link", "there is no link to the chassis")
        elif moves or self._has_to_stop():
            self._log.clear()
            self._obeyed = now
            self._waiting = self._clamped(*values)
            self._wake.set()

    def _has_to_stop(self) -> bool:
        """Whether a zero has something to stop that was asked for here."""
        if self._host.gate.driving or self._waiting is not None:
            return True
        return self.driving and not (self._host.actions.running_goals or self._wheels.user)

    def _objection(self) -> tuple[str, str]:
        """Why the robot may not be driven now, with a kind for the log; empty if it may."""
        if self._silenced:
            return "silenced", f"the robot was stopped; send a zero, or nothing for {_PAUSE_S:g} s"
        if self._host.settings().cmd_vel_override:
            return "", ""
        user = "a goal" if self._host.actions.running_goals else self._wheels.user
        if user:
            return "goal", f"{user} is running: cancel it, or set the parameter cmd_vel_override"
        return "", ""

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
            # the first stop waits for nothing
            first = stop and self.driving
            return 0.0 if first else self._sent + 1.0 / settings.cmd_vel_rate
        if self.driving and self._host.chassis.state is LinkState.READY:
            return self._obeyed + settings.cmd_vel_timeout
        return math.inf

    def _send_due(self) -> None:
        if self._waiting is not None:
            self._send(self._waiting)
        elif self._host.gate.driving:
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
            answer = await self._host.gate.request(self._host.requests.address(command))
        except SupersededError as error:  # everyday business while the chassis is slow
            _LOG.debug("cmd_vel: %s", error)
        except LinkError as error:
            self._log.warn("request", f"cmd_vel did not get through: {error}")
        else:
            if not answer.ok:
                self._log.warn("refused", f"the chassis refused cmd_vel: {answer.msg}")

    def _link_changed(self, state: LinkState) -> None:
        if state is not LinkState.READY:
            self._waiting = None
            self._owes_zero = self._owes_zero or self.driving
            self.driving = False
        elif self._owes_zero:
            self._owes_zero = False
            self._host.thread.call(self._zero_after_loss)

    def _zero_after_loss(self) -> None:
        """The robot was driving when the link went: stop it, unless somebody else drives it now."""
        if not (self._host.actions.running_goals or self._wheels.user):
            self._send(Twist())
