"""The parts of the page's data: texts, numbers and lists, ready for JSON, and the binary scan."""

from __future__ import annotations

import array
import math
import struct
import sys
import time
from typing import Any

from woosh_robot_agent.link.protos import enum_name
from woosh_robot_agent.motion.wheel_owner import is_running
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import (
    DeviceState,
    NavPath,
    RobotInfo,
    ScannerData,
    TaskProc,
)
from woosh_robot_agent.pb.ros.ros_pack_pb2 import State as ActionState
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.robot import readiness
from woosh_robot_agent.robot.readiness import accepts_task, is_charging, pose_doubt, rejections
from woosh_robot_agent.robot.status_codes import explained
from woosh_robot_agent.tools.robot_view import RobotView

_MAX_CODES = 20
"""Maximum number of status codes on the page."""
_MAX_POINTS = 2000
"""Maximum number of points of a path on the page."""
_MAX_MARKS = 2000
"""Maximum number of marks on the page."""

_SAME_MOMENT = 2.0
"""Longest time between the end of a task and its status code, in seconds."""
_TONES = {task.kCompleted: "good", task.kCanceled: "warning", task.kFailed: "bad"}
"""Colours of the ends of a task; other states have none."""

_HERE = "on a page with control"
_REMEDIES = {
    readiness.MANUAL.name: "turn the key switch to automatic; if it is there already, set Control "
    f"to automatic {_HERE} (the key switch overrides the mode set by software)",
    readiness.MAINTENANCE.name: f"finish the maintenance, then set Control to automatic {_HERE}",
    readiness.NO_CONTROL_MODE.name: "turn the key switch to automatic, or set Control to automatic "
    f"{_HERE}",
    readiness.DEPLOYMENT.name: f"save maps and marks, then set Work to task {_HERE}",
    readiness.SCHEDULE.name: f"send the task to the dispatch system, or set Work to task {_HERE}",
    readiness.NO_WORK_MODE.name: f"set Work to task {_HERE}",
    readiness.NOT_INITIALISED.name: f"choose Set pose {_HERE}, and show its pose on the map",
    readiness.LOST.name: f"choose Set pose {_HERE}, and show its actual pose on the map",
}
"""What to do about an objection with the means of the page, by the name of the objection."""


def pose_data(info: RobotInfo) -> dict[str, Any] | None:
    """Return pose and speed; None if the robot has not reported a finite pose."""
    if not info.pose_speed.HasField("pose"):
        return None
    pose, twist = info.pose_speed.pose, info.pose_speed.twist
    if not all(map(math.isfinite, (pose.x, pose.y, pose.theta))):
        return None
    doubt = pose_doubt(info)
    return {
        "x": round(pose.x, 4),
        "y": round(pose.y, 4),
        "theta": round(pose.theta, 4),
        "linear": _number(twist.linear),
        "angular": _number(twist.angular),
        "doubt": "" if doubt is None else doubt.reason,
    }


def robot_data(view: RobotView) -> dict[str, Any]:
    """Return everything that the page shows as text, except pose and status codes."""
    info = view.info
    return {
        "known": view.has_robot_info,
        "id": info.robot_id or info.genral.serial_number,
        "name": info.setting.identity.name,
        "model": info.genral.display_model,
        "scene": info.scene.scene_name,
        "map": info.scene.map_name,
        "state": enum_name(robot.State, info.state),
        "control": enum_name(robot.ControlMode, info.mode.ctrl) if info.HasField("mode") else None,
        "work": enum_name(robot.WorkMode, info.mode.work) if info.HasField("mode") else None,
        "modes": [info.mode.ctrl, info.mode.work],
        "emergencyStop": bool(info.device_state.hardware & DeviceState.kEmgBtn),
        "taskable": accepts_task(info),
        "objections": _objections(info),
        "battery": _battery(info),
        "task": _task(view),
        "actions": [_action(view, name) for name in sorted(view.actions)],
        "problems": [
            explained(code.code, code.msg) for code in info.abnormal_codes.scs[:_MAX_CODES]
        ],
    }


def summary(view: RobotView, address: str, trouble: str) -> str:
    """Return address, name and state of a robot in one line, for a list of robots.

    Args:
        view: state of the robot.
        address: address of the robot.
        trouble: why its state is not up to date; empty if it is.
    """
    info = view.info
    number = info.robot_id or info.genral.serial_number
    names = dict.fromkeys(str(each) for each in (number, info.setting.identity.name) if each)
    states = []
    if trouble:
        states.append(trouble)
    elif view.has_robot_info:
        states.append(enum_name(robot.State, info.state))
        twist = info.pose_speed.twist
        if _number(twist.linear) or _number(twist.angular):
            states.append("moving")
        if info.device_state.hardware & DeviceState.kEmgBtn:
            states.append("emergency stop")
        if any(code.level == StatusCode.kFault for code in info.abnormal_codes.scs):
            states.append("fault")
    return f"{' '.join([*names, address])}: {', '.join(states) or 'unknown'}"


def result_data(view: RobotView, command: str, proc: TaskProc, at: float) -> dict[str, Any]:
    """Return what has become of a task that a page has given.

    Args:
        view: state of the robot.
        command: name of the command.
        proc: last report about the task; without a state, its end was not seen.
        at: Unix time of that, in seconds.
    """
    text = f"{command} to {proc.dest}" if proc.dest else command
    if proc.state == task.kStateUndefined:
        state = "its end was not seen, and the robot no longer reports the task"
        return {"text": f"{text}: {state}", "tone": "bad", "time": int(at * 1000)}
    reasons = [proc.msg, _failure(view, proc) if proc.state == task.kFailed else ""]
    told = ": ".join([text, enum_name(task.State, proc.state), *filter(None, reasons)])
    return {"text": told, "tone": _TONES.get(proc.state, ""), "time": int(at * 1000)}


def codes_data(view: RobotView) -> list[dict[str, Any]]:
    """Return the last status codes, the newest first."""
    return [
        {
            "time": time.strftime("%m-%d %H:%M:%S", time.localtime(code.time / 1000)),
            "level": enum_name(StatusCode.Level, code.level),
            "text": explained(code.code, code.msg),
        }
        for code in list(view.codes)[: -_MAX_CODES - 1 : -1]
    ]


def outline_data(info: RobotInfo) -> list[list[float]]:
    """Return the corners of the robot's outline in its frame, in metres."""
    return _points(info.model.model)


def path_data(view: RobotView) -> list[list[float]]:
    """Return the points of the path that the robot follows, in metres."""
    nav_path = view.values.value(NavPath)
    poses = nav_path.path.poses if nav_path is not None else []
    step = math.ceil(len(poses) / _MAX_POINTS) or 1
    return _points(poses[::step])


def marks_data(area: SceneData.Map) -> list[dict[str, Any]]:
    """Return the marks of a map: number, description, type, and the pose of a robot there."""
    marks = []
    for storage in area.mark_info.storages[:_MAX_MARKS]:
        pose = storage.pose.dock
        if all(map(math.isfinite, (pose.x, pose.y, pose.theta))):
            marks.append(
                {
                    "number": storage.identity.no,
                    "text": storage.identity.desc,
                    "type": storage.WhichOneof("category") or "",
                    "x": round(pose.x, 3),
                    "y": round(pose.y, 3),
                    "theta": round(pose.theta, 3),
                }
            )
    return marks


def _objections(info: RobotInfo) -> list[list[str]]:
    """Return why the robot rejects a new task now, and what to do."""
    return [[each.reason, _REMEDIES.get(each.name, each.remedy)] for each in rejections(info)]


def _battery(info: RobotInfo) -> dict[str, Any] | None:
    if not info.HasField("battery"):
        return None
    return {"power": info.battery.power, "charging": is_charging(info.battery)}


def _task(view: RobotView) -> dict[str, Any] | None:
    info = view.info
    proc = info.task_proc
    if not info.HasField("task_proc") or proc.state == task.kStateUndefined:
        return None
    doing = proc.action
    return {
        "id": str(proc.robot_task_id),
        "type": enum_name(task.Type, proc.type),
        "to": proc.dest,
        "state": enum_name(task.State, proc.state),
        "running": is_running(proc),
        "text": proc.msg,
        "reason": _failure(view, proc) if proc.state == task.kFailed else "",
        "action": enum_name(action.Type, doing.type) if doing.type else "",
        "actionState": enum_name(action.State, doing.state) if doing.state else "",
    }


def _failure(view: RobotView, proc: TaskProc) -> str:
    """Return the status code with which a task failed, explained; empty if none is known."""
    for code in reversed(view.codes):
        of_task = code.robot_task_id == proc.robot_task_id
        at_its_end = not code.robot_task_id and abs(code.time / 1000.0 - proc.time) < _SAME_MOMENT
        if code.level in (StatusCode.kWarn, StatusCode.kFault) and (of_task or at_its_end):
            return explained(code.code, code.msg)
    return ""


def _action(view: RobotView, name: str) -> dict[str, str]:
    feedback = view.actions[name]
    text = explained(feedback.code, feedback.msg) if feedback.code else feedback.msg
    return {"name": name, "state": enum_name(ActionState, feedback.state), "text": text}


def _points(points: Any) -> list[list[float]]:
    return [
        [round(each.x, 3), round(each.y, 3)]
        for each in points
        if math.isfinite(each.x) and math.isfinite(each.y)
    ]


def _number(value: float) -> float:
    return round(value, 3) if math.isfinite(value) else 0.0


_HEADER = struct.Struct("<4x7f")
"""Pose x, y, theta of the robot; offset x, y of the laser; first angle, angle between two rays.

The first four bytes are zero, and the ranges follow: whole millimetres, as 16-bit integers. The
range 0 stands for no reflection. All is little-endian, in metres and radians.
"""
_MAX_RAYS = 10_000
"""Maximum number of rays that are sent."""
_MAX_RANGE = 65.535
"""Greatest range that can be expressed, in metres."""


def scan_frame(scan: ScannerData, pose: tuple[float, float, float]) -> bytes | None:
    """Return the message for a scan; None if the scan has no valid angles or pose.

    Args:
        scan: the scan.
        pose: pose of the robot, used if the scan has none.
    """
    if scan.HasField("pose"):
        pose = scan.pose.x, scan.pose.y, scan.pose.theta
    values = (*pose, scan.offset.x, scan.offset.y, scan.angle_min, scan.angle_increment)
    if not all(map(math.isfinite, values)):
        return None
    low, high = max(0.0, scan.range_min), min(scan.range_max or _MAX_RANGE, _MAX_RANGE)
    # a comparison with NaN is False
    measured = [int(r * 1000.0) if low <= r <= high else 0 for r in scan.ranges[:_MAX_RAYS]]
    ranges = array.array("H", measured)
    if sys.byteorder == "big":
        ranges.byteswap()
    return _HEADER.pack(*values) + ranges.tobytes()
