"""Make the data of the page's parts: numbers, names and lists for JSON, and the binary scan.

Names of states and modes are English words; the page translates them into its language. The fields
`genral` and `nav_filed` are spelled so in the robot's messages.
"""

from __future__ import annotations

import json
import math
import struct
import time
from collections.abc import Iterable, Mapping
from typing import Any

from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.link.protos import enum_name
from woosh_robot_agent.motion.wheel_owner import is_held_up, is_unfinished
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import (
    HardwareState,
    NavPath,
    RobotInfo,
    ScannerData,
    Scene,
    TaskProc,
)
from woosh_robot_agent.pb.ros.action_pb2 import MoveBase
from woosh_robot_agent.pb.ros.ros_pack_pb2 import State as ActionState
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.robot.readiness import (
    accepts_task,
    all_objections,
    devices,
    is_charging,
    objections,
    pose_problem,
)
from woosh_robot_agent.robot.standstill import ENDED
from woosh_robot_agent.robot.status_codes import meaning
from woosh_robot_agent.tools.dashboard.texts import value_data
from woosh_robot_agent.tools.robot_view import RobotView

_MAX_CODES = 50
"""Maximum number of problems on the page, i.e. of status codes that hold now."""
_MAX_POINTS = 2000
"""Maximum number of points of a path, zone or lane on the page."""
_MAX_MARKS = 2000
"""Maximum number of marks on the page."""
_MAX_ZONES = 500
"""Maximum number of zones, and of lanes, on the page."""
_MAX_ZONE_POINTS = 20_000
"""Maximum number of points of all zones, and of all lanes, on the page."""
_MAX_TYPES = 50
"""Maximum number of task kinds on the page."""
_MAX_NAME = 60
"""Maximum length of the name of a task kind."""


def pose_data(info: RobotInfo) -> dict[str, Any] | None:
    """Return pose in the map and speed, in m, rad, m/s and rad/s.

    None without a pose, or if a number is not finite. `doubt` says why the pose may mean nothing;
    it is None without a doubt.
    """
    if not info.pose_speed.HasField("pose"):
        return None
    pose, twist = info.pose_speed.pose, info.pose_speed.twist
    if not all(map(math.isfinite, (pose.x, pose.y, pose.theta, twist.linear, twist.angular))):
        return None
    doubt = pose_problem(info)
    return {
        "x": round(pose.x, 4),
        "y": round(pose.y, 4),
        "theta": round(pose.theta, 4),
        "linear": round(twist.linear, 3),
        "angular": round(twist.angular, 3),
        "doubt": None if doubt is None else doubt._asdict(),
    }


def robot_data(view: RobotView, lost_actions: Iterable[str]) -> dict[str, Any]:
    """Return the state of a robot, except its pose and its earlier status codes.

    `lost_actions` has the names of further actions, whose state is unknown.
    """
    info = view.info
    return {
        "known": view.has_robot_info,
        "id": info.robot_id or info.genral.serial_number,
        "name": info.setting.identity.name,
        "model": info.genral.display_model,
        **map_data(info.scene),
        "state": enum_name(robot.State, info.state),
        "control": enum_name(robot.ControlMode, info.mode.ctrl) if info.HasField("mode") else None,
        "work": enum_name(robot.WorkMode, info.mode.work) if info.HasField("mode") else None,
        "taskable": accepts_task(info),
        "objections": [each._asdict() for each in all_objections(info)],
        "battery": _battery(info),
        "task": _task(view),
        "actions": [
            *(_action(view, name) for name in sorted(view.actions)),
            *({"name": name, "state": "unknown", "text": ""} for name in sorted(lost_actions)),
        ],
        "problems": [code_data(each) for each in info.abnormal_codes.scs[:_MAX_CODES]],
        "sound": _sound(info),
        "light": info.HasField("hardware_state"),  # such a robot is taken to have a light
    }


def map_data(scene: Scene) -> dict[str, str]:
    """Return the names of the scene and of the map that a robot uses, and the map's version."""
    return {
        "scene": scene.scene_name,
        "map": scene.map_name,
        "version": str(scene.version),  # a browser rounds large numbers
    }


def details_data(view: RobotView, chassis: ChassisClient) -> dict[str, Any]:
    """Return values for technicians: software, network, hardware that is not normal, link.

    `mileage` is in metres. `clockOffset` is in seconds; it is None if unknown.
    """
    info, stats = view.info, chassis.stats
    return {
        "address": chassis.config.address,
        "software": info.genral.version.rc,
        "system": info.genral.version.system,
        "mileage": info.pose_speed.mileage,
        "wifi": info.network.wifi.name,
        "strength": info.network.wifi.strength,
        "parts": [
            {"part": name, "state": enum_name(HardwareState.State, state)}
            for name, state in devices(info.hardware_state)
            if state != HardwareState.kNormal
        ],
        "connects": stats.connects,
        "received": stats.rx,
        "sent": stats.tx,
        "invalid": stats.bad_frames.total(),
        "dropped": stats.dropped_pushes.total(),
        "clockOffset": None if stats.clock_offset is None else round(stats.clock_offset, 1),
    }


def card_data(view: RobotView, chassis: ChassisClient, silence: int) -> dict[str, Any]:
    """Return the data of a robot's card in the overview of all robots.

    `silence` is the time for which the robot has been connected but has sent nothing, in seconds.
    """
    info = view.info
    worst = max((code.level for code in info.abnormal_codes.scs), default=StatusCode.kNormal)
    objection = next(iter(objections(info)), None)
    twist = info.pose_speed.twist
    return {
        "address": chassis.config.address,
        "silence": silence,
        "known": view.has_robot_info,
        "id": info.robot_id or info.genral.serial_number,
        "name": info.setting.identity.name,
        "state": enum_name(robot.State, info.state),
        "objection": None if objection is None else objection._asdict(),
        "moves": bool(round(twist.linear, 3) or round(twist.angular, 3)),
        "problems": len(info.abnormal_codes.scs),
        "level": enum_name(StatusCode.Level, worst),
        "battery": _battery(info),
    }


def place_data(info: RobotInfo, index: int) -> dict[str, Any] | None:
    """Return map and pose of a robot, for the pages of other robots; None without a sure pose.

    `index` is that of the robot in the list of robots.
    """
    pose = pose_data(info)
    if pose is None or pose["doubt"]:
        return None
    return {
        "index": index,
        "name": info.setting.identity.name or str(info.robot_id or info.genral.serial_number),
        "scene": info.scene.scene_name,
        "map": info.scene.map_name,
        "outline": outline_data(info),
        **{name: pose[name] for name in ("x", "y", "theta")},
    }


def codes_data(view: RobotView, times: Mapping[tuple[int, ...], int]) -> list[dict[str, Any]]:
    """Return the last status codes, the newest first.

    `times` has their Unix times by this computer's clock, in milliseconds, by the keys of
    `view.codes`.
    """
    codes = reversed(view.codes.items())
    return [{"time": times[key], **code_data(code)} for key, code in codes]


def code_data(code: StatusCode) -> dict[str, Any]:
    """Return number, level, text and meaning of a status code; the meaning is empty if unknown."""
    return {
        "code": str(code.code),
        "level": enum_name(StatusCode.Level, code.level),
        "text": code.msg,
        "meaning": meaning(code.code),
    }


def outline_data(info: RobotInfo) -> list[list[float]]:
    """Return the corners of the robot's outline in its frame, in metres."""
    return points_data(info.model.model)


def path_data(view: RobotView) -> list[list[float]]:
    """Return the points of the path that the robot follows, in the map; empty without a path."""
    nav_path = view.values.value(NavPath)
    return points_data(nav_path.path.poses if nav_path is not None and may_navigate(view) else [])


def may_navigate(view: RobotView) -> bool:
    """Return True while a task, or a navigation without a task, runs or is paused."""
    navigation = view.actions.get(MoveBase.DESCRIPTOR.name)
    navigates = navigation is not None and navigation.state not in ENDED
    return navigates or is_unfinished(view.info.task_proc)


def task_state(report: TaskProc) -> str:
    """Return the state of a task: `held up` if it waits and then drives on by itself."""
    return "held up" if is_held_up(report) else enum_name(task.State, report.state)


def points_data(points: Any, max_points: int = _MAX_POINTS) -> list[list[float]]:
    """Return the x and y of points, in metres. Points that are not finite are left out.

    If there are more than `max_points`, only every second, third etc. point and the last one are
    returned.
    """
    last = len(points) - 1
    step = math.ceil(last / max_points) or 1
    return [
        [round(each.x, 3), round(each.y, 3)]
        for each in (*points[:last:step], *points[last:])
        if math.isfinite(each.x) and math.isfinite(each.y)
    ]


def marks_data(area: SceneData.Map) -> list[dict[str, Any]]:
    """Return the marks of a map: number, description, type, and the pose of a robot at the mark."""
    marks = []
    for storage in area.mark_info.storages[:_MAX_MARKS]:
        pose = storage.pose.dock
        if all(map(math.isfinite, (pose.x, pose.y, pose.theta))):
            marks.append(
                {
                    "number": storage.identity.no,
                    "text": storage.identity.desc,
                    "type": storage.WhichOneof("category") or "base",
                    "x": round(pose.x, 3),
                    "y": round(pose.y, 3),
                    "theta": round(pose.theta, 3),
                }
            )
    return marks


def zones_data(area: SceneData.Map) -> list[dict[str, Any]]:
    """Return the zones of a map: kind, corners, and maximum speed in m/s; 0 without a limit."""
    zones = []
    found = [
        (field.name, each)
        for field, fields in area.field_info.ListFields()
        if field.name != "guide_markers"  # all other fields are lists of zones
        for each in fields
    ][:_MAX_ZONES]
    for kind, each in found:
        outline = points_data(each.nav_filed.vertexs, _points_each(found))
        if len(outline) > 2:
            speed = each.nav_filed.max_speed
            speed = round(speed, 3) if math.isfinite(speed) else 0.0
            zones.append({"kind": kind, "outline": outline, "speed": speed})
    return zones


def lanes_data(area: SceneData.Map) -> list[list[list[float]]]:
    """Return the lanes of a map, on which robots should drive: the points of each, in metres."""
    paths: list[Any] = [*area.path_info.mono_paths, *area.path_info.bidirect_paths][:_MAX_ZONES]
    lanes = (points_data(each.path, _points_each(paths)) for each in paths)
    return [each for each in lanes if len(each) > 1]


def _points_each(found: list[Any]) -> int:
    """Return how many points the page may show of each of these zones or lanes."""
    return min(_MAX_POINTS, _MAX_ZONE_POINTS // len(found))


def task_types_data(scene: SceneData) -> list[dict[str, Any]]:
    """Return the kinds of tasks of a scene: type, number and name; empty if they are not known.

    They are in the scene's file action_groups.json, which the robot passes on unchanged.
    """
    found: dict[tuple[str, int], str] = {}
    try:
        content = json.loads(scene.action_group or "{}")
        for each in content["task_type"]:
            kind, number, name = each["type"], each["no"], each["name"]
            if kind in task.Type.values() and isinstance(number, int) and isinstance(name, str):
                found[enum_name(task.Type, kind), number] = name[:_MAX_NAME]
    except (ValueError, TypeError, KeyError, RecursionError):
        return []
    return [
        {"type": kind, "number": number, "name": name}
        for (kind, number), name in list(found.items())[:_MAX_TYPES]
    ]


def _battery(info: RobotInfo) -> dict[str, Any] | None:
    if not info.HasField("battery"):
        return None
    battery = info.battery
    return {
        "power": battery.power,
        "charging": is_charging(battery),
        "temperature": battery.temp_max,
        "cycles": battery.charge_cycle,
        "low": info.setting.power.low,
    }


def _sound(info: RobotInfo) -> dict[str, Any] | None:
    if not info.setting.HasField("sound"):
        return None
    return {"mute": info.setting.sound.mute, "volume": info.setting.sound.volume}


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
        "state": task_state(proc),
        "running": is_unfinished(proc),
        "text": proc.msg,
        "action": enum_name(action.Type, doing.type) if doing.type else "",
        "actionState": enum_name(action.State, doing.state) if doing.state else "",
    }


def _action(view: RobotView, name: str) -> dict[str, Any]:
    feedback = view.actions[name]
    return {
        "name": name,
        "state": enum_name(ActionState, feedback.state),
        "text": value_data(feedback.msg or meaning(feedback.code)),
    }


def now() -> int:
    """Return the Unix time, in milliseconds."""
    return int(time.time() * 1000.0)


_HEADER = struct.Struct("<4x7f")
"""Header of the message for a scan, which the ranges follow; all is little-endian.

Four unused bytes; x, y and theta of the robot's pose; x and y of the laser in the robot's frame;
the first angle and the angle between two rays; in metres and radians. The ranges are whole
millimetres, as 16-bit integers; 0 means no reflection.
"""
_MAX_RAYS = 10_000
"""Maximum number of ranges of a scan that are sent."""
_MAX_RANGE = 65.535
"""Greatest range that can be expressed, in metres."""


def scan_frame(scan: ScannerData, pose: tuple[float, float, float]) -> bytes | None:
    """Return the message for a scan; None if a value of its header is not finite.

    `pose` is x, y and theta of the robot, in metres and radians; used if the scan has no pose.
    """
    if scan.HasField("pose"):
        pose = scan.pose.x, scan.pose.y, scan.pose.theta
    values = (*pose, scan.offset.x, scan.offset.y, scan.angle_min, scan.angle_increment)
    if not all(map(math.isfinite, values)):
        return None
    low, high = max(0.0, scan.range_min), min(scan.range_max or _MAX_RANGE, _MAX_RANGE)
    # a range that is not a number becomes 0, because each comparison with it is False
    ranges = [int(r * 1000.0) if low <= r <= high else 0 for r in scan.ranges[:_MAX_RAYS]]
    return _HEADER.pack(*values) + struct.pack(f"<{len(ranges)}H", *ranges)
