"""The state of the robot as VDA 5050 reports it: status, errors for status codes, and factsheet."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import Battery as BatteryReport
from woosh_robot_agent.pb.robot.robot_pb2 import DeviceState, OperationState, RobotInfo
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.robot import readiness
from woosh_robot_agent.robot.standstill import MIN_SPEED
from woosh_robot_agent.robot.status_codes import explained
from woosh_robot_agent.vda5050.messages.factsheet import (
    ActionType,
    Factsheet,
    Limits,
)
from woosh_robot_agent.vda5050.messages.state import (
    Battery,
    ErrorLevel,
    OperatingMode,
    Position,
    RobotStatus,
    VehicleError,
    Velocity,
)

_TYPE = "robotStatusCode"
"""Type of the errors for status codes."""
_LEVELS = {StatusCode.kWarn: ErrorLevel.WARNING, StatusCode.kFault: ErrorLevel.FATAL}
"""Levels of errors, by the level of the status code; codes of other levels are no errors."""
_HINT = "resolve the cause at the robot; the error ends when the robot does not report it any more"
_SAFETY_SCANNERS = 110203
"""First six digits of the status codes of safety scanners, which have twelve digits."""
_LAST_SIX_DIGITS = 10**6
"""Divisor that removes the last six digits of a status code."""


def code_errors(codes: AbnormalCodes) -> tuple[VehicleError, ...]:
    """Return the errors for the status codes that are not resolved; each code counts once."""
    latest = {code.code: code for code in codes.scs if code.level in _LEVELS}
    return tuple(
        VehicleError(
            type=_TYPE,
            level=_LEVELS[code.level],
            description=explained(code.code, code.msg),
            hint=_HINT,
            references=(("statusCode", str(code.code)),),
        )
        for code in latest.values()
    )


def field_violated(codes: AbnormalCodes) -> bool:
    """Return True if a safety scanner has tripped."""
    return any(
        code.code // _LAST_SIX_DIGITS == _SAFETY_SCANNERS and code.level in _LEVELS
        for code in codes.scs
    )


_MODES = {
    robot.kDeployMode: OperatingMode.TEACH_IN,
    robot.kTaskMode: OperatingMode.AUTOMATIC,
}
"""Operating modes in automatic control mode, by work mode; MANUAL in other work modes."""


def robot_status(info: RobotInfo) -> RobotStatus:
    """Return the state of a robot, without its maps and path."""
    return RobotStatus(
        driving=drives(info),
        mode=_operating_mode(info),
        battery=_battery(info.battery),
        emergency_stop=bool(info.device_state.hardware & DeviceState.kEmgBtn),
        field_violation=field_violated(info.abnormal_codes),
        position=position(info),
        velocity=velocity(info),
        loaded=_loaded(info),
        errors=code_errors(info.abnormal_codes),
        blocked=_blocked(info),
    )


def drives(info: RobotInfo) -> bool:
    """Return True if the robot moves, by its last report."""
    motion = info.pose_speed.twist
    # `not <=`: NaN counts as moving
    return not (abs(motion.linear) <= MIN_SPEED and abs(motion.angular) <= MIN_SPEED)


def _operating_mode(info: RobotInfo) -> OperatingMode:
    """Return the operating mode of the robot."""
    if info.mode.ctrl == robot.kMaintain:
        return OperatingMode.SERVICE
    if info.mode.ctrl != robot.kAuto:
        return OperatingMode.MANUAL
    return _MODES.get(info.mode.work, OperatingMode.MANUAL)


def position(info: RobotInfo) -> Position | None:
    """Return the position of the robot; None if it is on no map, or unknown."""
    report = info.pose_speed
    place = report.pose
    if not (report.map_id or _is_on_map_0(info)):
        return None
    if not all(map(math.isfinite, (place.x, place.y, place.theta))):
        return None
    return Position(
        x=_rounded(place.x),
        y=_rounded(place.y),
        theta=_rounded(math.remainder(place.theta, math.tau)),
        map_id=map_id(info),
        # is_located is None if the robot does not report it, or is building a map
        initialised=info.state != robot.kUninit and readiness.is_located(info) is not False,
    )


def _is_on_map_0(info: RobotInfo) -> bool:
    """Return True if the robot is on a map with the id 0, which otherwise means no map.

    While the robot builds a map, its pose does not belong to the map of the scene.
    """
    has_map = bool(info.scene.map_name) and not info.scene.map_id
    return has_map and info.HasField("pose_speed") and info.state != robot.kMapping


def velocity(info: RobotInfo) -> Velocity | None:
    """Return the velocity of the robot; None if it does not report a finite velocity."""
    motion = info.pose_speed.twist
    if not info.pose_speed.HasField("twist"):
        return None
    if not (math.isfinite(motion.linear) and math.isfinite(motion.angular)):
        return None
    return Velocity(_rounded(motion.linear), _rounded(motion.angular))


def points(reported: Iterable[Any]) -> tuple[tuple[float, float], ...]:
    """Return the points with finite coordinates, in metres."""
    return tuple(
        (_rounded(point.x), _rounded(point.y))
        for point in reported
        if math.isfinite(point.x) and math.isfinite(point.y)
    )


def map_id(info: RobotInfo) -> str:
    """Return the id of the map in which the robot reports its position.

    It is the name of the map, or its number if the last report on the scene names another map.
    """
    report = info.pose_speed
    if info.scene.map_name and info.scene.map_id in (0, report.map_id):
        return info.scene.map_name
    return str(report.map_id)


def _battery(report: BatteryReport) -> Battery:
    return Battery(
        charge=float(min(report.power, 100)),
        charging=readiness.is_charging(report),
        health=float(report.health) if 0 < report.health <= 100 else None,
    )


def _loaded(info: RobotInfo) -> bool | None:
    """Return True if the robot carries a load, False if not, None if it does not detect loads."""
    if info.device_state.software & DeviceState.kGoodsState:
        return True
    return False if info.setting.allow.goods_check else None


def _blocked(info: RobotInfo) -> bool:
    """Return True if the robot reports that an obstacle is in its way."""
    proc = info.task_proc
    has_task = proc.state in (task.kExecuting, task.kPaused)
    is_impeded = bool(info.operation_state.nav & OperationState.kImpede)
    # a TR-200 reports an obstacle as a warning of the action of its task
    return is_impeded or (has_task and proc.action.state == action.kRosWarning)


def _rounded(value: float) -> float:
    """Round a 32-bit float to six decimals, because further decimals are noise."""
    return round(value, 6)


def serial_number(info: RobotInfo) -> str:
    """Return the serial number of a robot, or its id if it reports no serial number."""
    return str(info.genral.serial_number or info.robot_id)  # spelled so in the robot's messages


_MM = 0.001
"""Metres in a millimetre."""
_CLASSES = {
    robot.kTractorRobot_500: "TUGGER",
    robot.kRollerRobot_500: "CONVEYOR",
}
"""VDA 5050 classes of robots, by the robot's type; all other types are carriers."""
_DIFFERENTIAL = 0
"""Value of `General.driver_method` for a differential drive."""


def factsheet(info: RobotInfo, limits: Limits, actions: tuple[ActionType, ...]) -> Factsheet:
    """Return the factsheet of a robot."""
    general = info.genral  # spelled so in the robot's messages
    size = general.model_data
    version = general.version
    versions = (("robot system", version.system), ("robot application", version.rc))
    return Factsheet(
        series=general.display_model or general.urdf_name,
        description=general.urdf_name,
        kinematics="DIFF" if general.driver_method == _DIFFERENTIAL else "OMNI",
        vehicle_class=_CLASSES.get(general.type, "CARRIER"),
        max_load=float(size.load),
        length=size.length * _MM,
        width=size.width * _MM,
        height=size.height * _MM,
        outline=points(info.model.model),
        limits=limits,
        actions=actions,
        versions=tuple((key, value) for key, value in versions if value),
    )
