"""What the robot reports, in the Foxglove schemas, which viewers show without configuration."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import (
    Battery,
    Model,
    NavPath,
    PoseSpeed,
    RobotInfo,
    ScannerData,
)
from woosh_robot_agent.status_codes import explained
from woosh_robot_agent.tools.recording.channel import Channel, protobuf_channel

MAP_FRAME = "map"
"""Frame of poses, paths and maps."""
ROBOT_FRAME = "base_link"
"""Frame of the robot."""
_POSE = protobuf_channel("/view/pose", PoseInFrame)
_TRANSFORM = protobuf_channel("/view/tf", FrameTransform)
_PATH = protobuf_channel("/view/path", PosesInFrame)
_SCAN = protobuf_channel("/view/scan", LaserScan)
_ROBOT = protobuf_channel("/view/robot", SceneUpdate)
_STATUS_CODES = protobuf_channel("/view/status_codes", Log)
_LEVELS = {
    StatusCode.kNormal: Log.INFO,
    StatusCode.kTips: Log.INFO,
    StatusCode.kWarn: Log.WARNING,
    StatusCode.kFault: Log.ERROR,
}
_TEXT_HEIGHT = 1.0
"""Height of the text above the robot, in metres."""


class View(NamedTuple):
    """A message to look at, and its channel.

    Attributes:
        channel: Channel of the message.
        message: The message.
        state: Name of the state that it shows until the next one of this name; empty for an event.
    """

    channel: Channel
    message: Message
    state: str = ""


def views_of(message: Message, time: int) -> Iterator[View]:
    """Yield the views of a message of the chassis.

    Args:
        message: The message.
        time: Time of recording, in ns.
    """
    make = _VIEWS.get(type(message))
    if make is not None:
        yield from make(message, timestamp(time))


def timestamp(time: int) -> Timestamp:
    """Return a time in ns as a message."""
    seconds, nanos = divmod(time, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanos)


def pose(x: float, y: float, theta: float, z: float = 0.0) -> Pose:
    """Return a pose in the plane as a message."""
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=_rotation(theta))


def _rotation(theta: float) -> Quaternion:
    if not math.isfinite(theta):
        theta = 0.0
    return Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2))


def _pose_speed(report: PoseSpeed, time: Timestamp) -> Iterator[View]:
    at = report.pose
    if not all(map(math.isfinite, (at.x, at.y, at.theta))):
        return
    position, rotation = Vector3(x=at.x, y=at.y), _rotation(at.theta)
    shown = Pose(position=position, orientation=rotation)
    yield View(_POSE, PoseInFrame(timestamp=time, frame_id=MAP_FRAME, pose=shown), "pose")
    yield View(
        _TRANSFORM,
        FrameTransform(
            timestamp=time,
            parent_frame_id=MAP_FRAME,
            child_frame_id=ROBOT_FRAME,
            translation=position,
            rotation=rotation,
        ),
        "transform",
    )


def _path(report: NavPath, time: Timestamp) -> Iterator[View]:
    poses = [pose(each.x, each.y, each.theta) for each in report.path.poses]
    yield View(_PATH, PosesInFrame(timestamp=time, frame_id=MAP_FRAME, poses=poses), "path")


def _scan(report: ScannerData, time: Timestamp) -> Iterator[View]:
    least, most = report.range_min, report.range_max
    offset = report.offset
    yield View(
        _SCAN,
        LaserScan(
            timestamp=time,
            frame_id=ROBOT_FRAME,
            pose=pose(offset.x, offset.y, 0.0, offset.z),
            start_angle=report.angle_min,
            end_angle=report.angle_max,
            # viewers show no point for an infinite range
            ranges=[each if least <= each <= most else math.inf for each in report.ranges],
        ),
    )


def _battery(report: Battery, time: Timestamp) -> Iterator[View]:
    charging = report.charge_state in (Battery.kManual, Battery.kAuto)
    text = TextPrimitive(
        pose=pose(0.0, 0.0, 0.0, _TEXT_HEIGHT),
        billboard=True,
        font_size=14,
        scale_invariant=True,
        color=Color(r=0.2, g=0.6, b=0.2, a=1.0),
        text=f"{report.power} %" + (", charging" if charging else ""),
    )
    yield _on_robot("battery", time, texts=[text])


def _outline(report: Model, time: Timestamp) -> Iterator[View]:
    line = LinePrimitive(
        type=LinePrimitive.LINE_LOOP,
        pose=pose(0.0, 0.0, 0.0),
        thickness=0.03,
        points=[Point3(x=corner.x, y=corner.y) for corner in report.model],
        color=Color(r=0.1, g=0.4, b=0.9, a=1.0),
    )
    yield _on_robot("outline", time, lines=[line])


def _on_robot(name: str, time: Timestamp, **primitives: Any) -> View:
    """Return a view that moves with the robot and replaces the former one of the same name."""
    entity = SceneEntity(
        timestamp=time, frame_id=ROBOT_FRAME, id=name, frame_locked=True, **primitives
    )
    return View(_ROBOT, SceneUpdate(entities=[entity]), name)


def _status_code(report: StatusCode, time: Timestamp) -> Iterator[View]:
    yield View(
        _STATUS_CODES,
        Log(
            timestamp=time,
            level=_LEVELS.get(report.level, Log.UNKNOWN),
            message=explained(report.code, report.msg),
            name="status code",
        ),
    )


def _robot_info(report: RobotInfo, time: Timestamp) -> Iterator[View]:
    for name, make in (("pose_speed", _pose_speed), ("battery", _battery), ("model", _outline)):
        if report.HasField(name):
            yield from make(getattr(report, name), time)


_VIEWS: dict[type[Message], Callable[[Any, Timestamp], Iterator[View]]] = {
    Battery: _battery,
    Model: _outline,
    NavPath: _path,
    PoseSpeed: _pose_speed,
    RobotInfo: _robot_info,
    ScannerData: _scan,
    StatusCode: _status_code,
}
