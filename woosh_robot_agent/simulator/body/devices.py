"""The devices of the robot: what a job can own, the battery and the lifts."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.profile import BatteryProfile
from woosh_robot_agent.simulator.refusals import RefusedError


class Device(Enum):
    """A device that at most one running job owns; NONE for jobs that need no device."""

    WHEELS = auto()
    JACK = auto()
    COLUMN = auto()
    CHARGER = auto()
    NONE = auto()


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


@dataclass
class Lift:
    """A vertical axis.

    Attributes:
        name: Name for texts.
        device: Device that a job owns while it moves the lift.
        travel: Maximum height, in metres; the minimum is 0.
        default_speed: Speed if a request gives none, in m/s.
        height: Current height, in metres.
    """

    name: str
    device: Device
    travel: float
    default_speed: float
    height: float = 0.0

    @property
    def raised(self) -> bool:
        """True if the lift is above the middle of its travel."""
        return self.height > self.travel / 2

    def checked(self, height: float) -> float:
        """Return `height` if the lift can reach it.

        Raises:
            RefusedError: The height is out of range.
        """
        if not 0.0 <= height <= self.travel + 1e-6:
            raise RefusedError(
                refusals.LIFT_OUT_OF_RANGE, lift=self.name, height=height, limit=self.travel
            )
        return min(height, self.travel)
