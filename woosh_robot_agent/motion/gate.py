"""The gate through which every request that moves the robot passes."""

from __future__ import annotations

from collections.abc import Callable

from google.protobuf.message import Message

from woosh_robot_agent.link import Answer, ChassisClient


class MotionGate:
    """Passes commands on to the chassis.

    Args:
        chassis: the link; used in its event loop only.
    """

    def __init__(self, chassis: ChassisClient) -> None:
        self._chassis = chassis

    async def request(
        self,
        message: Message,
        timeout: float | None = None,
        *,
        first: bool = False,
        tap: Callable[[Answer], None] | None = None,
    ) -> Answer:
        """Send a command and wait for the answer; see `ChassisClient.request`."""
        return await self._chassis.request(message, timeout, first=first, tap=tap)

    def withdraw(self, reason: str, seconds: float) -> None:
        """Send nothing that moves the robot; see `ChassisClient.withdraw_motion`."""
        self._chassis.withdraw_motion(reason, seconds)

    @property
    def driving(self) -> bool:
        """Whether the robot may still drive by a velocity that was sent here."""
        return self._chassis.driving

    async def stop_driving(self, timeout: float) -> None:
        """Send a zero velocity if the last one that was sent was not zero."""
        await self._chassis.stop_driving(timeout)
