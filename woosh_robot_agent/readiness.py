"""Why a robot would refuse a task, in words: the rules that tools and diagnostics share. No ROS."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import (
    Battery,
    DeviceState,
    HardwareState,
    OperationState,
    RobotInfo,
)
from woosh_robot_agent.pb.util import robot_pb2 as robot


class Objection(NamedTuple):
    """One reason for which the robot would refuse a task.

    Attributes:
        name: short constant name, the same whatever the texts say, e.g. `emergency_stop`.
        reason: what is wrong.
        remedy: what to do about it.
    """

    name: str
    reason: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.reason}: {self.remedy}"


EMERGENCY_STOP = Objection(
    "emergency_stop",
    "the emergency stop is pressed",
    "see that nobody is in danger, then release the button",
)
MANUAL = Objection(
    "manual",
    "the robot is in manual mode",
    "turn the key switch to automatic; if it stands there, call robot/SwitchControlMode with mode 1"
    " (the key switch overrules what software set)",
)
MAINTENANCE = Objection(
    "maintenance",
    "the robot is in maintenance mode",
    "when the maintenance is over, call robot/SwitchControlMode with mode 1",
)
NO_CONTROL_MODE = Objection(
    "no_control_mode",
    "the robot has no control mode",
    "turn the key switch to automatic, or call robot/SwitchControlMode with mode 1",
)
DEPLOYMENT = Objection(
    "deployment",
    "the robot is in deployment mode, not in task mode",
    "when maps and marks are saved, call robot/SwitchWorkMode with mode 2",
)
SCHEDULE = Objection(
    "schedule",
    "the robot is in schedule mode, not in task mode: a dispatch system drives it",
    "give the task to the dispatch system, or call robot/SwitchWorkMode with mode 2",
)
NO_WORK_MODE = Objection(
    "no_work_mode",
    "the robot has no work mode, so it is not in task mode",
    "call robot/SwitchWorkMode with mode 2",
)
NOT_INITIALISED = Objection(
    "not_initialised",
    "the robot is not initialised",
    "call robot/InitRobot with its pose, or with is_record true where it was switched off",
)
LOST = Objection(
    "lost",
    "the robot has lost its localisation",
    "call robot/SetRobotPose or robot/InitRobot with the pose where it really is",
)
BATTERY_EMPTY = Objection("battery_empty", "the battery is empty", "charge it")

_CONTROL_MODES = {
    robot.kControlModeUndefined: NO_CONTROL_MODE,
    robot.kManual: MANUAL,
    robot.kMaintain: MAINTENANCE,
}
_WORK_MODES = {
    robot.kWorkModeUndefined: NO_WORK_MODE,
    robot.kDeployMode: DEPLOYMENT,
    robot.kScheduleMode: SCHEDULE,
}
_STATES = {
    robot.kMapping: Objection("mapping", "the robot is building a map", "end that first"),
    robot.kFollowing: Objection(
        "following", "the robot is following somebody", "end that with robot/Follow"
    ),
    robot.kCharging: Objection("charging", "the robot is charging", "wait, or end the charging"),
}


def objections(info: RobotInfo) -> list[Objection]:
    """Every reason for which the robot would refuse a task now; none if it would take one.

    What `info` does not hold counts as right: nothing is known of it. A robot that says that it
    is not taskable has at least one reason, if only that it names none.

    Args:
        info: what the robot reports, its parts up to date.
    """
    found = list(_certain(info))
    if is_taskable(info) is False:
        # at 0 percent some still drive, so this alone does not keep a task away
        if info.battery.charge_state == Battery.kNot and info.battery.power == 0:
            found.append(BATTERY_EMPTY)
        found += _failed_parts(info.hardware_state)
        found += [] if found else _likely(info)
    return found


def is_taskable(info: RobotInfo) -> bool | None:
    """Whether the robot says that it can take a task; None if it does not say."""
    if not info.HasField("operation_state"):
        return None
    return bool(info.operation_state.robot & OperationState.kTaskable)


def is_located(info: RobotInfo) -> bool | None:
    """Whether the robot knows where it is; None if it does not say."""
    if not info.HasField("device_state"):
        return None
    return bool(info.device_state.software & DeviceState.kLocation)


def _certain(info: RobotInfo) -> Iterator[Objection]:
    """What keeps tasks away by itself, whatever else is the matter."""
    if info.device_state.hardware & DeviceState.kEmgBtn:
        yield EMERGENCY_STOP
    if info.HasField("mode"):
        if info.mode.ctrl in _CONTROL_MODES:
            yield _CONTROL_MODES[info.mode.ctrl]
        # without automatic control an unset work mode says nothing
        automatic = info.mode.ctrl == robot.kAuto
        if info.mode.work in _WORK_MODES and (automatic or info.mode.work):
            yield _WORK_MODES[info.mode.work]
    if info.state == robot.kUninit:
        yield NOT_INITIALISED
    elif is_located(info) is False:  # until it is initialised it cannot know where it is
        yield LOST


def _failed_parts(hardware: HardwareState) -> Iterator[Objection]:
    for field, value in hardware.ListFields():
        if field.enum_type is None:
            continue
        states = [value] if isinstance(value, int) else list(value)
        for number, state in enumerate(states, start=1):
            if state == HardwareState.kFatal:
                part = field.name if len(states) == 1 else f"{field.name} {number}"
                yield Objection(
                    "hardware",
                    f"a part of the robot has failed ({part})",
                    "switch the robot off and on; if it stays, have it repaired",
                )


def _likely(info: RobotInfo) -> list[Objection]:
    """Why the robot is probably not taskable, where nothing certain is known."""
    remedy = "see to what the text says; it is over when the code is gone from robot/AbnormalCodes"
    found = [
        Objection("fault", f"the robot reports a fault ({code.code}: {code.msg})", remedy)
        for code in info.abnormal_codes.scs
        if code.level == StatusCode.kFault
    ]
    if info.state in _STATES:
        found.append(_STATES[info.state])
    if info.device_state.software & DeviceState.kOccupancy:
        found.append(
            Objection(
                "occupied",
                "the robot is marked as occupied",
                "call robot/SetOccupancy with occupy false",
            )
        )
    return found or [
        Objection(
            "not_taskable",
            "the robot says that it is not taskable, and not why",
            "wait for the end of what it does, look at its status codes, or at its own screen",
        )
    ]
