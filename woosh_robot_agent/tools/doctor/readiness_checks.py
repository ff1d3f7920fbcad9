"""Checks of the robot's state for reasons to reject a task."""

from __future__ import annotations

from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.readiness import (
    DEPLOYMENT,
    EMERGENCY_STOP,
    LOST,
    MAINTENANCE,
    MANUAL,
    NO_CONTROL_MODE,
    NO_WORK_MODE,
    NOT_INITIALISED,
    SCHEDULE,
    Objection,
    accepts_task,
    is_located,
    objections,
    pose_doubt,
    rejections,
)
from woosh_robot_agent.status_codes import explained
from woosh_robot_agent.tools.doctor.result import Result, Status
from woosh_robot_agent.tools.enum_names import enum_name

_MODES = (MANUAL, MAINTENANCE, NO_CONTROL_MODE, DEPLOYMENT, SCHEDULE, NO_WORK_MODE)
_NOT_REPORTED = Result(
    Status.WARN,
    "the robot does not report it",
    "look at the robot's own screen; its firmware may be too old to report it",
)


def check_mode(info: RobotInfo) -> Result:
    """Check the control mode and the work mode."""
    if not info.HasField("mode"):
        return _NOT_REPORTED
    if found := [objection for objection in objections(info) if objection in _MODES]:
        return _failed(found)
    control = enum_name(robot.ControlMode, info.mode.ctrl)
    work = enum_name(robot.WorkMode, info.mode.work)
    return Result(Status.OK, f"control {control}, work {work}")


def check_initialisation(info: RobotInfo) -> Result:
    """Check that the robot is initialised."""
    if NOT_INITIALISED in objections(info):
        return _failed([NOT_INITIALISED])
    if info.state == robot.kStateUndefined:
        return _NOT_REPORTED
    if info.state == robot.kFault:
        return Result(Status.SKIPPED, "hidden by a fault: run doctor again when that is cleared")
    return Result(Status.OK, f"state {enum_name(robot.State, info.state)}")


def check_localisation(info: RobotInfo) -> Result:
    """Check that the robot knows its position."""
    if info.state == robot.kUninit:
        return Result(Status.SKIPPED, "not checked until the robot is initialised")
    if info.state == robot.kMapping:
        return Result(Status.SKIPPED, "not checked while the robot is building a map")
    result = _check(is_located(info), LOST, "the robot knows its position")
    doubt = pose_doubt(info)
    if result.status is Status.OK and doubt is not None:
        return Result(Status.WARN, doubt.reason, doubt.remedy)
    return result


def check_emergency_stop(info: RobotInfo) -> Result:
    """Check that the emergency stop is released."""
    is_pressed = EMERGENCY_STOP in objections(info)
    is_known = info.HasField("device_state")
    return _check(not is_pressed if is_known else None, EMERGENCY_STOP, "not pressed")


def check_taskable(info: RobotInfo) -> Result:
    """Check whether the robot would accept a new task."""
    reported = {*_MODES, NOT_INITIALISED, LOST, EMERGENCY_STOP}
    found = rejections(info)
    if others := [objection for objection in found if objection not in reported]:
        return _failed(others)
    if found:
        return Result(
            Status.FAIL,
            "the robot rejects tasks, for the reasons above",
            "resolve the failed checks above",
        )
    if accepts_task(info) is None:
        return _NOT_REPORTED
    return Result(Status.OK, "the robot accepts a new task")


def check_codes(info: RobotInfo) -> Result:
    """Report the problems that the robot has reported and that are not resolved."""
    codes = [explained(code.code, code.msg) for code in info.abnormal_codes.scs]
    if codes:
        return Result(Status.WARN, "; ".join(codes), "resolve what the codes report")
    return Result(Status.OK, "no unresolved problem is reported")


def _check(good: bool | None, objection: Objection, text: str) -> Result:
    """Return the result for a condition that is true, false or unknown."""
    if good is None:
        return _NOT_REPORTED
    return Result(Status.OK, text) if good else _failed([objection])


def _failed(found: list[Objection]) -> Result:
    reasons = "; ".join(objection.reason for objection in found)
    remedies = "; ".join(dict.fromkeys(objection.remedy for objection in found))
    return Result(Status.FAIL, reasons, remedies)
