"""The battery."""

from __future__ import annotations

from woosh_robot_agent.pb.robot import robot_pb2

_IDLE_PERCENT_PER_S = 1.0 / 3600.0
_DRIVING_PERCENT_PER_M = 0.005
_CHARGING_PERCENT_PER_S = 60.0 / 3600.0


class Battery:
    """A battery that drains with time and motion, and charges.

    Attributes:
        level: Percent, 0 to 100.
        charging: Whether it is being charged, and how.
    """

    def __init__(self, level: float) -> None:
        self.level = level
        self.charging: robot_pb2.Battery.ChargeState = robot_pb2.Battery.kNot

    @property
    def percent(self) -> int:
        """The level as the chassis reports it."""
        return round(self.level)

    @property
    def charges(self) -> bool:
        """Whether it is being charged."""
        return self.charging != robot_pb2.Battery.kNot

    def tick(self, dt: float, driven: float) -> None:
        """Account for `dt` seconds in which the base drove `driven` metres."""
        change = -_IDLE_PERCENT_PER_S * dt - _DRIVING_PERCENT_PER_M * driven
        if self.charges:
            change += _CHARGING_PERCENT_PER_S * dt
        self.level = min(100.0, max(0.0, self.level + change))
