"""The battery of the robot."""

from __future__ import annotations

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.simulator.profile import BatteryProfile


class Battery:
    """A battery that drains with time and distance, and can be charged.

    Args:
        level: Charge at the start, in percent.
        profile: Rates, and values that are only reported.

    Attributes:
        level: Charge, in percent.
        profile: Rates, and values that are only reported.
        charging: State of charging.
    """

    def __init__(self, level: float, profile: BatteryProfile) -> None:
        self.level = level
        self.profile = profile
        self.charging: robot_pb2.Battery.ChargeState = robot_pb2.Battery.kNot

    @property
    def percent(self) -> int:
        """Charge as reported to clients: whole percent."""
        return round(self.level)

    @property
    def charges(self) -> bool:
        """True if the battery is being charged."""
        return self.charging != robot_pb2.Battery.kNot

    def tick(self, dt: float, driven: float) -> None:
        """Update the charge after `dt` seconds in which the base drove `driven` metres."""
        change = -self.profile.idle_drain * dt - self.profile.driving_drain * driven
        if self.charges:
            change += self.profile.charging_rate * dt
        self.level = min(100.0, max(0.0, self.level + change))
