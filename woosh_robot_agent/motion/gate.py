"""The gate through which every request that moves the robot passes."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable, Coroutine
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link import Answer, ChassisClient, LinkState, SupersededError
from woosh_robot_agent.link.drop_log import DropLog
from woosh_robot_agent.motion import latest_wins
from woosh_robot_agent.motion.latest_wins import LatestWins
from woosh_robot_agent.motion.requests import commands_motion, may_move, takes_wheels
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist

_LOG = logging.getLogger(__name__)

DRIVING = 3 * latest_wins.STALL
"""Time after a velocity in which the robot may still drive by it, in seconds.

The chassis goes on with a velocity for a while, and then slows down by itself.
"""


class MotionGate:
    """Passes commands on to the chassis, by the rules of motion.

    Args:
        chassis: the link; used in its event loop only.

    Attributes:
        superseded: number of velocities that were not sent because they were out of date.
    """

    def __init__(self, chassis: ChassisClient) -> None:
        self._chassis = chassis
        self._send = chassis.reserve(commands_motion)
        self.superseded = 0
        self._drops = DropLog(_LOG)
        self._latest = LatestWins[Answer]()
        self._last_velocity = Twist()
        self._drives_until = -math.inf
        self._withdrawn = ("", -math.inf)
        """Why nothing that moves the robot is sent, and the loop's time until when."""
        chassis.on_state(self._link_changed)

    async def request(
        self,
        message: Message,
        timeout: float | None = None,
        *,
        first: bool = False,
        tap: Callable[[Answer], None] | None = None,
    ) -> Answer:
        """Send a command and wait for the answer; see `ChassisClient.request`."""
        if not commands_motion(message):
            return await self._chassis.request(message, timeout, first=first, tap=tap)
        if not isinstance(message, Twist):
            return await self._pass(message, timeout, first=first, tap=tap)

        def send(send_within: float) -> Coroutine[Any, Any, Answer]:
            return self._pass(
                message, timeout, first=first, urgent=True, send_within=send_within, tap=tap
            )

        try:
            return await self._latest.request(message, send)
        except SupersededError as error:
            self.superseded += 1
            self._drops.count("velocity commands were out of date and not sent", str(error))
            raise

    async def _pass(
        self, message: Message, timeout: float | None, *, first: bool, **options: Any
    ) -> Answer:
        reason, until = self._withdrawn
        moves = may_move(message)
        if moves and not first and asyncio.get_running_loop().time() < until:
            raise SupersededError(f"not sent: {reason}")
        if isinstance(message, Twist):
            self._last_velocity = message
            if moves and self._chassis.state is LinkState.READY:
                self._drives_until = time.monotonic() + DRIVING
        answer = await self._send(message, timeout, first=first, **options)
        if (answer.ok and takes_wheels(message)) or (message is self._last_velocity and not moves):
            self._drives_until = -math.inf
        return answer

    def withdraw(self, reason: str, seconds: float) -> None:
        """Send nothing that moves the robot: neither what waits to be sent nor what comes now.

        Callers get a SupersededError. A request that is sent `first` is not affected.

        Args:
            reason: why.
            seconds: for how long what comes now is not sent either.
        """
        self._withdrawn = reason, asyncio.get_running_loop().time() + seconds
        self._latest.withdraw(f"not sent: {reason}")
        self._chassis.withdraw(may_move, reason)

    @property
    def driving(self) -> bool:
        """True if the robot may still drive by a velocity that was sent here."""
        return time.monotonic() < self._drives_until

    async def stop_driving(self, timeout: float) -> None:
        """Send a zero velocity if the robot may still drive by a velocity that was sent here.

        Raises:
            LinkError: the chassis did not confirm it within `timeout` seconds.
        """
        if self.driving and self._chassis.state is LinkState.READY:
            await self.request(Twist(), timeout)

    def _link_changed(self, state: LinkState) -> None:
        if state is LinkState.STOPPED:
            self._drops.finish()
