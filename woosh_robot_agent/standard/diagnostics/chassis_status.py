"""Status of the robot: its state, its modes, and why it would refuse a task."""

from __future__ import annotations

from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.readiness import accepts_task, is_located, objections, pose_doubt
from woosh_robot_agent.standard.diagnostics.status import ERROR, WARN, Status, name_of


def chassis_status(info: RobotInfo) -> Status:
    """Return the status of the robot: state, modes, and each reason why it would refuse a task."""
    status = Status("chassis")
    for objection in objections(info):
        status.tell(WARN, str(objection))
    if (doubt := pose_doubt(info)) is not None:
        status.tell(WARN, str(doubt))
    if info.state == robot.kFault:
        status.tell(ERROR, "the robot reports a fault")
    status.values = {
        "state": name_of(robot.State, info.state),
        "control mode": name_of(robot.ControlMode, info.mode.ctrl),
        "work mode": name_of(robot.WorkMode, info.mode.work),
        "taskable": _yes_or_no(accepts_task(info)),
        "localised": _yes_or_no(is_located(info)),
        "scene": info.scene.scene_name,
        "map": info.scene.map_name,
        "map id": info.pose_speed.map_id if info.HasField("pose_speed") else "unknown",
    }
    return status


def _yes_or_no(value: bool | None) -> str:
    return "unknown" if value is None else "yes" if value else "no"
