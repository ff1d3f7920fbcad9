"""Battery and lifts of the robot, and its modes and conditions.

Methods that execute a request raise `RefusedError` for values that the device cannot use.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.profile import BatteryProfile
from woosh_robot_agent.simulator.refusals import Refusal, RefusedError


class Device(Enum):
    """A device that at most one running job owns; NONE for jobs that need no device."""

    WHEELS = auto()
    JACK = auto()  # the lift of LiftControl
    COLUMN = auto()  # the lift of LiftControl2 and LiftControl3
    CHARGER = auto()
    NONE = auto()


@dataclass
class Battery:
    """A battery that drains with time and distance, and can be charged.

    Attributes:
        level: charge, in percent.
        profile: drain and charge rates, and constants that are reported but not simulated, e.g.
            `health`.
        charging: state of charging, `kNot` if the battery is not being charged.
    """

    level: float
    profile: BatteryProfile
    charging: robot_pb2.Battery.ChargeState = robot_pb2.Battery.kNot

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


_ROUNDING = 1e-6
"""Rounding error of a height that clients send with single precision, in metres."""


@dataclass
class Lift:
    """A lift, whose height is at least 0.

    Attributes:
        name: name for the texts of refusals.
        device: device that a job owns while it moves the lift.
        travel: maximum height, in metres.
        default_speed: speed if a request gives none, in m/s.
        height: current height, in metres.
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
        """Return a height that the lift can reach: `height`, without a rounding error."""
        if not -_ROUNDING <= height <= self.travel + _ROUNDING:
            raise RefusedError(f"{self.name}: {height:.3f} m is not within 0 to {self.travel:g} m")
        return min(max(height, 0.0), self.travel)


@dataclass
class Readiness:
    """The modes and conditions that decide whether the robot may move by itself.

    Attributes:
        requested_control: control mode that a client requested last.
        key_manual: True if the key switch is at manual, which overrides `requested_control` and
            switches the motors off.
        key_accepts: True if requests are accepted although the key switch is at manual.
        work: work mode.
        initialised: True if the robot is initialised. False after a mapping or maintenance until
            InitRobot, and while InitRobot is executed.
        located: True if the robot knows its pose.
        emergency_stop: True if the emergency stop button is pressed.
        battery_empty: True if the battery is empty.
    """

    requested_control: util_robot_pb2.ControlMode = util_robot_pb2.kAuto
    key_manual: bool = False
    key_accepts: bool = False
    work: util_robot_pb2.WorkMode = util_robot_pb2.kTaskMode
    initialised: bool = True
    located: bool = True
    emergency_stop: bool = False
    battery_empty: bool = False

    @property
    def control(self) -> util_robot_pb2.ControlMode:
        """The effective control mode."""
        return util_robot_pb2.kManual if self.key_manual else self.requested_control

    @property
    def motors_on(self) -> bool:
        """True unless the key switch is at manual."""
        return not self.key_manual

    @property
    def ready(self) -> bool:
        """True if the robot may move by itself."""
        return not self._reasons_not_ready()

    @property
    def refusal(self) -> Refusal | None:
        """The first reason to refuse or stop tasks and actions, None if there is none.

        With `key_accepts`, the key switch is no such reason.
        """
        tolerated = refusals.KEY_AT_MANUAL if self.key_accepts else None
        reasons = (each for each in self._reasons_not_ready() if each is not tolerated)
        return next(reasons, None)

    def require_ready(self) -> None:
        """Raise RefusedError if the robot does not accept tasks and actions now."""
        if self.refusal:
            raise RefusedError(self.refusal)

    def require_located(self) -> None:
        """Raise RefusedError if the robot is not initialised, or does not know its pose."""
        if not self.initialised:
            raise RefusedError(refusals.NOT_INITIALISED)
        if not self.located:
            raise RefusedError(refusals.LOCALISATION_LOST)

    def _reasons_not_ready(self) -> list[Refusal]:
        """Return every reason why the robot may not move by itself."""
        manual, maintenance = util_robot_pb2.kManual, util_robot_pb2.kMaintain
        deployment, schedule = util_robot_pb2.kDeployMode, util_robot_pb2.kScheduleMode
        conditions = (
            (self.emergency_stop, refusals.EMERGENCY_STOP),
            (self.key_manual, refusals.KEY_AT_MANUAL),
            (self.requested_control == manual, refusals.MANUAL_MODE),
            (self.requested_control == maintenance, refusals.MAINTENANCE_MODE),
            (self.work == deployment, refusals.DEPLOYMENT_MODE),
            (self.work == schedule, refusals.SCHEDULE_MODE),
            (not self.initialised, refusals.NOT_INITIALISED),
            (self.initialised and not self.located, refusals.LOCALISATION_LOST),
            (self.battery_empty, refusals.BATTERY_EMPTY),
        )
        return [refusal for applies, refusal in conditions if applies]
