"""What a chassis can be busy with for a while, alone or as a part of a task."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING, Protocol

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.chassis import Chassis


class Device(Enum):
    """What a job occupies: two jobs on one device exclude each other."""

    WHEELS = auto()
    JACK = auto()
    COLUMN = auto()
    CHARGER = auto()
    NONE = auto()


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a job is.

    Attributes:
        done: It is finished, well or not.
        failure: Why it failed; empty if it did not.
        text: How far it is, for people.
        impeded: An obstacle holds it up just now, which `text` tells.
    """

    done: bool = False
    failure: str = ""
    text: str = ""
    impeded: bool = False


class Job(Protocol):
    """One thing the chassis does over time.

    Attributes:
        device: What it occupies.
        kind: The `woosh.action.Type` that reports give it.
    """

    device: Device
    kind: util_action_pb2.Type

    def tick(self, chassis: Chassis, dt: float) -> Progress:
        """Work for `dt` seconds of simulated time."""

    def hold(self, chassis: Chassis) -> None:
        """Let go: the next tick may come later and elsewhere, or never."""


def failed(reason: str) -> Progress:
    """The progress of a job that cannot go on."""
    return Progress(done=True, failure=reason)


class Wait:
    """Standing still for some seconds, infinitely many included, or until it is broken off."""

    device = Device.NONE
    kind = util_action_pb2.kWait

    def __init__(self, seconds: float) -> None:
        self._left = seconds

    def tick(self, chassis: Chassis, dt: float) -> Progress:
        """See `Job.tick`."""
        self._left -= dt
        if self._left == math.inf:
            return Progress(text="waits for the order to go on")
        return Progress(done=self._left <= 0.0, text=f"{max(0.0, self._left):.0f} s to wait")

    def hold(self, chassis: Chassis) -> None:
        """See `Job.hold`."""

    def break_off(self) -> None:
        """Wait no longer."""
        self._left = 0.0


class Charge:
    """Charging at a charger, until the level that the settings call full."""

    device = Device.CHARGER
    kind = util_action_pb2.kCharge

    def tick(self, chassis: Chassis, dt: float) -> Progress:
        """See `Job.tick`."""
        if not chassis.at_charger():
            return failed("not at a charger")
        full = chassis.setting.power.full
        if chassis.battery.level >= full:
            return Progress(done=True, text=f"charged to {full} %")
        chassis.battery.charging = robot_pb2.Battery.kAuto
        return Progress(text=f"at {chassis.battery.percent} of {full} %")

    def hold(self, chassis: Chassis) -> None:
        """See `Job.hold`: the charge ends."""
        chassis.battery.charging = robot_pb2.Battery.kNot


class EndCharge:
    """Ending whatever charge goes on."""

    device = Device.CHARGER
    kind = util_action_pb2.kCharge

    def tick(self, chassis: Chassis, dt: float) -> Progress:
        """See `Job.tick`."""
        chassis.battery.charging = robot_pb2.Battery.kNot
        return Progress(done=True, text="not charging")

    def hold(self, chassis: Chassis) -> None:
        """See `Job.hold`."""
