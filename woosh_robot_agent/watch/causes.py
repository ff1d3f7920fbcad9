"""Likely causes why a robot does not move although it has accepted a command."""

from __future__ import annotations

from collections.abc import Iterator

from woosh_robot_agent.pb.robot.robot_pb2 import Battery, DeviceState, RobotInfo
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.readiness import is_located

_KEY = "the key switch is at manual"
_STOP = "the emergency stop is pressed"
_BRAKE = "the brake or the servo drives are released"
_OBSTACLE = "an obstacle is in the way"
_CHARGER = "the charging cable is connected"
_LOST = "the robot does not know its position"


def likely_causes(info: RobotInfo) -> str:
    """Return the likely causes, those that the robot reports first and what it rules out last."""
    reported: list[str] = []
    possible: list[str] = []
    excluded: list[str] = []
    for cause, state in _causes(info):
        (possible if state is None else reported if state else excluded).append(cause)
    parts = [f"the robot reports that {cause}" for cause in reported]
    parts += [f"perhaps {cause}" for cause in possible]
    text = ", ".join(parts)
    if excluded:
        text += f"; less likely, because the robot reports otherwise: {', '.join(excluded)}"
    return text


def _causes(info: RobotInfo) -> Iterator[tuple[str, bool | None]]:
    """Yield each cause: True if the robot reports it, False if it reports the opposite."""
    has_device_state = info.HasField("device_state")
    hardware = info.device_state.hardware
    yield _STOP, bool(hardware & DeviceState.kEmgBtn) if has_device_state else None
    # software can set the reported mode to automatic while the key switch is at manual
    yield _KEY, True if info.mode.ctrl == robot.kManual else None
    yield _BRAKE, True if hardware & DeviceState.kServoBtn else None
    yield _OBSTACLE, None
    charging = info.battery.charge_state in (Battery.kManual, Battery.kAuto)
    yield _CHARGER, charging if info.HasField("battery") else None
    located = is_located(info)
    yield _LOST, None if located is None else not located
