"""The battery of the robot."""

from __future__ import annotations

from woosh_robot_agent.pb.robot import robot_pb2

_IDLE_DRAIN = 1.0 / 3600.0
"""Discharge with time, in percent per second."""

_DRIVING_DRAIN = 0.005
"""Discharge with distance, in percent per metre."""

_CHARGING_RATE = 60.0 / 3600.0
"""Rate of charging, in percent per second."""


class Battery:
    """A battery that drains with time and distance, and can be charged.

    Attributes:
        level: Charge, in percent.
        charging: State of charging.
    """

    def __init__(self, level: float) -> None:
        self.level = level
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
        change = -_IDLE_DRAIN * dt - _DRIVING_DRAIN * driven
        if self.charges:
            change += _CHARGING_RATE * dt
        self.level = min(100.0, max(0.0, self.level + change))
