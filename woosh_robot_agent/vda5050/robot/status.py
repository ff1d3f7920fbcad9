"""The state of the robot from its reports."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from woosh_robot_agent import readiness
from woosh_robot_agent.pb.robot.robot_pb2 import Battery as BatteryReport
from woosh_robot_agent.pb.robot.robot_pb2 import DeviceState, NavPath, OperationState, RobotInfo
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.vda5050.model.state import (
    Battery,
    EmergencyStop,
    OperatingMode,
    Position,
    RobotStatus,
    Velocity,
)
from woosh_robot_agent.vda5050.robot.code_errors import code_errors, field_violated
from woosh_robot_agent.watch.standstill import MIN_SPEED

_MODES = {
    robot.kDeployMode: OperatingMode.TEACH_IN,
    robot.kTaskMode: OperatingMode.AUTOMATIC,
}
"""Operating modes in automatic control mode, by work mode; in other work modes it is MANUAL."""


def robot_status(info: RobotInfo) -> RobotStatus:
    """Return the state of a robot."""
    return RobotStatus(
        driving=drives(info),
        mode=operating_mode(info),
        battery=_battery(info.battery),
        emergency_stop=EmergencyStop.MANUAL
        if info.device_state.hardware & DeviceState.kEmgBtn
        else EmergencyStop.NONE,
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
    return not (abs(motion.linear) <= MIN_SPEED and abs(motion.angular) <= MIN_SPEED)


def operating_mode(info: RobotInfo) -> OperatingMode:
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
    if not report.map_id or not all(map(math.isfinite, (place.x, place.y, place.theta))):
        return None
    return Position(
        x=_rounded(place.x),
        y=_rounded(place.y),
        theta=_rounded(math.remainder(place.theta, math.tau)),
        map_id=map_id(info),
        initialised=info.state != robot.kUninit and readiness.is_located(info) is not False,
    )


def velocity(info: RobotInfo) -> Velocity | None:
    """Return the velocity of the robot; None if it does not report one."""
    motion = info.pose_speed.twist
    if not info.pose_speed.HasField("twist"):
        return None
    if not (math.isfinite(motion.linear) and math.isfinite(motion.angular)):
        return None
    return Velocity(_rounded(motion.linear), _rounded(motion.angular))


def path(report: NavPath | None) -> tuple[tuple[float, float], ...]:
    """Return the points of the path that the robot follows; empty if it follows none."""
    return () if report is None else points(report.path.poses)


def points(reported: Iterable[Any]) -> tuple[tuple[float, float], ...]:
    """Return points of the robot's, in metres, without those that are not finite."""
    return tuple(
        (_rounded(point.x), _rounded(point.y))
        for point in reported
        if math.isfinite(point.x) and math.isfinite(point.y)
    )


def map_id(info: RobotInfo) -> str:
    """Return the id of the map that the robot's position belongs to."""
    report = info.pose_speed
    if info.scene.map_name and info.scene.map_id in (0, report.map_id):
        return info.scene.map_name
    return str(report.map_id)


def _battery(report: BatteryReport) -> Battery:
    return Battery(
        charge=float(min(report.power, 100)),
        charging=report.charge_state in (BatteryReport.kManual, BatteryReport.kAuto),
        health=float(report.health) if 0 < report.health <= 100 else None,
    )


def _loaded(info: RobotInfo) -> bool | None:
    """Return True if the robot carries a load; None if it does not detect loads."""
    if info.device_state.software & DeviceState.kGoodsState:
        return True
    return False if info.setting.allow.goods_check else None


def _blocked(info: RobotInfo) -> bool:
    """Return True if the robot reports that an obstacle is in its way."""
    proc = info.task_proc
    has_task = proc.state in (task.kExecuting, task.kPaused)
    is_impeded = bool(info.operation_state.nav & OperationState.kImpede)
    return is_impeded or (has_task and proc.action.state == action.kRosWarning)


def _rounded(value: float) -> float:
    """Round a 32-bit float to the decimals that it really has."""
    return round(value, 6)
