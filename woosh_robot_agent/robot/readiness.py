"""Reasons for which a robot rejects tasks, for tools and diagnostics. Independent of ROS.

`objections` returns the reasons in the state of the robot, `busy_objections` what it is doing, and
`all_objections` both. `accepts_task` predicts whether the robot would accept a new task.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from woosh_robot_agent.motion.wheel_owner import is_unfinished
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import (
    Battery,
    DeviceState,
    HardwareState,
    OperationState,
    RobotInfo,
)
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.robot.status_codes import explained
from woosh_robot_agent.sentences import Said


class Objection(NamedTuple):
    """One reason for which the robot rejects tasks or other requests.

    Attributes:
        name: identifier for programs, e.g. `emergency_stop`; unlike the texts, it never changes.
        reason: what is wrong.
        remedy: what to do about it; may be empty.
    """

    name: str
    reason: str
    remedy: str

    @property
    def said(self) -> Said:
        """The reason, as a text that the dashboard can translate."""
        if isinstance(self.reason, Said):
            return self.reason
        return Said(self.reason, f"objection.{self.name}.reason")

    def __str__(self) -> str:
        return f"{self.reason}: {self.remedy}" if self.remedy else self.reason


EMERGENCY_STOP = Objection(
    "emergency_stop",
    "the emergency stop is pressed",
    "make sure that nobody is in danger, then release the button",
)
MANUAL = Objection(
    "manual",
    "the robot is in manual mode",
    "turn the key switch to automatic; if it is there already, call robot/SwitchControlMode with "
    "mode 1 (the key switch overrides the mode set by software)",
)
MAINTENANCE = Objection(
    "maintenance",
    "the robot is in maintenance mode",
    "finish the maintenance, then call robot/SwitchControlMode with mode 1",
)
NO_CONTROL_MODE = Objection(
    "no_control_mode",
    "the robot has no control mode",
    "turn the key switch to automatic, or call robot/SwitchControlMode with mode 1",
)
DEPLOYMENT = Objection(
    "deployment",
    "the robot is in deployment mode, not in task mode",
    "save maps and marks, then call robot/SwitchWorkMode with mode 2",
)
NOT_DEPLOYMENT = Objection(
    "not_deployment",
    "the robot is not in deployment mode",
    "call robot/SwitchWorkMode with mode 1",
)
SCHEDULE = Objection(
    "schedule",
    "the robot is in schedule mode, not in task mode: a dispatch system controls it",
    "send the task to the dispatch system, or call robot/SwitchWorkMode with mode 2",
)
NO_WORK_MODE = Objection(
    "no_work_mode",
    "the robot has no work mode, so it is not in task mode",
    "call robot/SwitchWorkMode with mode 2",
)
NOT_INITIALISED = Objection(
    "not_initialised",
    "the robot is not initialised",
    "call robot/InitRobot with its pose, or with is_record true if it has not been moved since it "
    "was switched off",
)
LOST = Objection(
    "lost",
    "the robot has lost its localisation",
    "call robot/SetRobotPose or robot/InitRobot with its actual pose",
)
BATTERY_EMPTY = Objection("battery_empty", "the battery is empty", "charge it")
NOT_TASKABLE = Objection(
    "not_taskable",
    "the robot reports that it rejects tasks, but not why",
    "wait until it has finished what it is doing, or check its status codes and its screen",
)
MAPPING = Objection(
    "mapping",
    "the robot is building a map",
    "save the map or cancel it, with type 4 or 3 of robot/BuildMap",
)
NO_TASK = Objection("no_task", "the robot is not executing a task", "start one first")

_BY_CONTROL_MODE = {
    robot.kControlModeUndefined: NO_CONTROL_MODE,
    robot.kManual: MANUAL,
    robot.kMaintain: MAINTENANCE,
}
"""Objections by control mode."""
CONTROL_MODES = tuple(_BY_CONTROL_MODE.values())
"""All objections to the control mode."""
_BY_WORK_MODE = {
    robot.kWorkModeUndefined: NO_WORK_MODE,
    robot.kDeployMode: DEPLOYMENT,
    robot.kScheduleMode: SCHEDULE,
}
"""Objections by work mode."""
_BY_STATE = {
    robot.kMapping: MAPPING,
    robot.kFollowing: Objection(
        "following", "the robot is following a person", "stop it with robot/Follow"
    ),
    robot.kCharging: Objection("charging", "the robot is charging", "wait, or stop charging"),
}
"""Objections by state of a robot that is not taskable."""
_BUSY = Objection("busy", "the robot is executing a task", "wait for its end, or cancel it")
_BUSY_BY_STATE = {
    robot.kTask: _BUSY,
    # also the state of a charging task
    robot.kParking: _BUSY._replace(reason="the robot is executing a charging or parking task"),
    robot.kMapping: MAPPING,
    robot.kFollowing: _BY_STATE[robot.kFollowing],
}
"""Objections of `busy_objections`, by state of the robot."""
_POSE_WITHOUT_MAP = Objection(
    "no_map",
    "the pose may mean nothing, because it belongs to no map (map_id 0)",
    "load a map with robot/SwitchMap, then call robot/InitRobot",
)


def all_objections(info: RobotInfo) -> list[Objection]:
    """Return every reason for which the robot rejects a new task now, e.g. its present task."""
    found, busy = objections(info), busy_objections(info)
    if busy:  # what the robot is doing tells why it is not taskable
        found = [each for each in found if each != NOT_TASKABLE]
    return list(dict.fromkeys([*found, *busy]))  # without duplicates


def objections_except_busy(info: RobotInfo) -> list[Objection]:
    """Return the reasons that remain when the robot has finished what it is doing."""
    busy = busy_objections(info)
    return [each for each in all_objections(info) if each not in busy]


def accepts_task(info: RobotInfo) -> bool | None:
    """Return True if the robot would accept a new task; None if its reports do not tell."""
    return False if all_objections(info) else is_taskable(info)


def objections(info: RobotInfo) -> list[Objection]:
    """Return every reason for which the robot rejects tasks, whatever it is doing now.

    A part that is absent from `info` gives no reason. If the robot reports that it is not taskable
    and no part tells why, the only reason is `not_taskable`.
    """
    found = list(_certain(info))
    if is_taskable(info) is False:
        # Some robots still accept tasks at 0 percent, so this is no reason by itself.
        if info.battery.charge_state == Battery.kNot and info.battery.power == 0:
            found.append(BATTERY_EMPTY)
        found += _failed_parts(info.hardware_state)
        if not found:
            found = _likely(info)
    return found


def busy_objections(info: RobotInfo) -> list[Objection]:
    """Return what the robot is doing, as the objection to another task.

    Empty if it is idle, or if it charges without a task.
    """
    proc = info.task_proc
    if is_unfinished(proc):
        number = proc.robot_task_id
        return [_BUSY._replace(reason=f"the robot is executing task {number}") if number else _BUSY]
    return [_BUSY_BY_STATE[info.state]] if info.state in _BUSY_BY_STATE else []


def is_taskable(info: RobotInfo) -> bool | None:
    """Return True if the robot reports that it accepts tasks; None without such a report."""
    if not info.HasField("operation_state"):
        return None
    return bool(info.operation_state.robot & OperationState.kTaskable)


def is_charging(battery: Battery) -> bool:
    """Return True if the robot reports that it is charging."""
    return battery.charge_state in (Battery.kManual, Battery.kAuto)


def is_located(info: RobotInfo) -> bool | None:
    """Return True if the robot knows its position, False if not; None if its reports do not tell.

    A robot that builds a map may report that it does not know its position. Then this is None, too,
    because there is no map yet in which the robot could be lost.
    """
    if not info.HasField("device_state"):
        return None
    located = bool(info.device_state.software & DeviceState.kLocation)
    return None if not located and info.state == robot.kMapping else located


def pose_problem(info: RobotInfo) -> Objection | None:
    """Return why the reported pose may mean nothing; None if there is no reason, or no pose.

    While the robot builds a map, its pose belongs to that map, which may have no id yet.
    """
    pose = info.pose_speed
    if not info.HasField("pose_speed") or pose.map_id or info.state == robot.kMapping:
        return None
    loaded_map_has_id_0 = info.scene.map_name and not info.scene.map_id
    if not loaded_map_has_id_0:
        return _POSE_WITHOUT_MAP
    return Objection(
        "map_id_0",
        f"the pose may mean nothing, because map {info.scene.map_name} has the id 0, as if there "
        "were no map",
        "compare the pose with where the robot is; if they differ, load the map again with "
        "robot/SwitchMap, then call robot/InitRobot",
    )


def _certain(info: RobotInfo) -> Iterator[Objection]:
    """Yield the reasons that are certain, even if the robot reports that it is taskable."""
    if info.device_state.hardware & DeviceState.kEmgBtn:
        yield EMERGENCY_STOP
    if info.HasField("mode"):
        if info.mode.ctrl in _BY_CONTROL_MODE:
            yield _BY_CONTROL_MODE[info.mode.ctrl]
        # Without automatic control, an undefined work mode has no meaning.
        is_automatic = info.mode.ctrl == robot.kAuto
        has_meaning = is_automatic or info.mode.work != robot.kWorkModeUndefined
        if has_meaning and info.mode.work in _BY_WORK_MODE:
            yield _BY_WORK_MODE[info.mode.work]
    if info.state == robot.kUninit:
        yield NOT_INITIALISED
    elif is_located(info) is False:  # an uninitialised robot is never located
        yield LOST


def _failed_parts(hardware: HardwareState) -> Iterator[Objection]:
    """Yield an objection for each part that is reported as failed."""
    for part, state in devices(hardware):
        if state == HardwareState.kFatal:
            yield Objection(
                "hardware",
                f"a part of the robot has failed ({part})",
                "switch the robot off and on; if the failure remains, have it repaired",
            )


def devices(hardware: HardwareState) -> Iterator[tuple[str, int]]:
    """Yield each device and its `HardwareState.State`; devices of one kind are numbered from 1."""
    for descriptor in HardwareState.DESCRIPTOR.fields:
        if descriptor.enum_type is None:  # not the state of a device
            continue
        value = getattr(hardware, descriptor.name)
        if isinstance(value, int):
            yield descriptor.name, value
        else:
            yield from ((f"{descriptor.name} {i}", each) for i, each in enumerate(value, start=1))


def _likely(info: RobotInfo) -> list[Objection]:
    """Return the probable reasons why a robot is not taskable, if no reason is certain."""
    remedy = "resolve it; it is resolved when robot/AbnormalCodes no longer has the code"
    found = [
        Objection("fault", f"the robot reports a fault ({explained(code.code, code.msg)})", remedy)
        for code in info.abnormal_codes.scs
        if code.level == StatusCode.kFault
    ]
    if info.state in _BY_STATE:
        found.append(_BY_STATE[info.state])
    if info.device_state.software & DeviceState.kOccupancy:
        found.append(
            Objection(
                "occupied",
                "the robot is marked as occupied",
                "call robot/SetOccupancy with occupy false",
            )
        )
    return found or [NOT_TASKABLE]
