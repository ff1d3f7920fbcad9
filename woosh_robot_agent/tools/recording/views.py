"""Make what Foxglove shows of the chassis's frames: decoded messages, views and maps.

A view is a message with a Foxglove schema, e.g. the laser scan or the path.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from woosh_robot_agent.endpoints import COMMANDS
from woosh_robot_agent.link.codecs import server_codec
from woosh_robot_agent.link.frames import SUBSCRIPTION_TYPE, Envelope, FrameError
from woosh_robot_agent.link.protos import full_name, message_types
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot import robot_pb2 as robot
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import BuildMapData
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.robot import maps
from woosh_robot_agent.robot.last_known import parts_of
from woosh_robot_agent.robot.readiness import is_charging
from woosh_robot_agent.robot.status_codes import explained
from woosh_robot_agent.tools.recording.layout import Channel, Side, protobuf_channel

_LOG = logging.getLogger(__name__)
_ANSWERS = {command.request: command.answer for command in COMMANDS if command.two_types}
"""Types of answers, by type of the request: those whose frames may name the type of the request."""
_MAX_TIMESTAMP = 2**63 // 1_000_000
"""Timestamp from which a time is invalid, in ms: viewers cannot represent it in ns."""


class DecodedFrame(NamedTuple):
    """The message in a frame.

    Attributes:
        channel: channel for this type of message from this side.
        sent: time of sending by the sender's clock, as Unix time in ns; None if the frame has no
            valid time.
    """

    channel: Channel
    message: Message
    sent: int | None


def decode_message(sender: Side, frame: str | bytes) -> DecodedFrame | None:
    """Return the message in a frame that `sender` has sent.

    None if the frame is invalid, of an unknown type, or refuses a request.
    """
    codec = server_codec(frame)
    try:
        envelope = codec.decode(frame)
        if envelope.ok is False:
            return None
        name = _type_of(sender, envelope)
        cls = message_types().get(name)
        if cls is None:
            return None
        return DecodedFrame(_channel(sender, name), codec.body(envelope, cls), _sent_at(envelope))
    except FrameError:
        return None


def _type_of(sender: Side, envelope: Envelope) -> str:
    """Return the protobuf full name of the message in a frame."""
    if envelope.type == SUBSCRIPTION_TYPE:  # not a full name
        return full_name(Subscription)
    # an answer, which may name the type of its request
    if sender == "chassis" and envelope.ok is not None:
        return _ANSWERS.get(envelope.type, envelope.type)
    return envelope.type


@cache
def _channel(sender: Side, name: str) -> Channel:
    """Return the channel for a known type of message from one side."""
    topic = f"/{sender}/{name.removeprefix('woosh.').replace('.', '/')}"
    return protobuf_channel(topic, message_types()[name])


def _sent_at(envelope: Envelope) -> int | None:
    """Return the time of sending, as Unix time in ns; None if the frame has no valid time."""
    timestamp = envelope.timestamp
    if timestamp is None or not 0 < timestamp < _MAX_TIMESTAMP:
        return None
    return timestamp * 1_000_000


MAP_FRAME = "map"
"""Coordinate frame of poses, paths and maps."""
ROBOT_FRAME = "base_link"
"""Coordinate frame of the robot."""
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
    """A message for display, and its channel.

    Attributes:
        state: key of a view that stays valid until the next view with this key. Such a view is
            repeated at the start of each file of a split recording. Empty for any other view.
    """

    channel: Channel
    message: Message
    state: str = ""


def views_of(message: Message, time: int) -> Iterator[View]:
    """Yield the views of a message of the chassis; `time` is that of recording, in ns."""
    for part in parts_of(message) if isinstance(message, robot.RobotInfo) else [message]:
        make = _VIEWS.get(type(part))
        if make is not None:
            yield from make(part, timestamp(time))


def timestamp(time: int) -> Timestamp:
    """Return a Unix time in ns as a message."""
    seconds, nanos = divmod(time, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanos)


def pose(x: float, y: float, theta: float, z: float = 0.0) -> Pose:
    """Return a pose in m and rad as a message; a `theta` that is not finite counts as 0."""
    if not math.isfinite(theta):
        theta = 0.0
    rotation = Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2))
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=rotation)


def _pose_speed(report: robot.PoseSpeed, time: Timestamp) -> Iterator[View]:
    at = report.pose
    if not all(map(math.isfinite, (at.x, at.y, at.theta))):
        return
    shown = pose(at.x, at.y, at.theta)
    yield View(_POSE, PoseInFrame(timestamp=time, frame_id=MAP_FRAME, pose=shown), "pose")
    yield View(
        _TRANSFORM,
        FrameTransform(
            timestamp=time,
            parent_frame_id=MAP_FRAME,
            child_frame_id=ROBOT_FRAME,
            translation=shown.position,
            rotation=shown.orientation,
        ),
        "transform",
    )


def _path(report: robot.NavPath, time: Timestamp) -> Iterator[View]:
    poses = [pose(each.x, each.y, each.theta) for each in report.path.poses]
    yield View(_PATH, PosesInFrame(timestamp=time, frame_id=MAP_FRAME, poses=poses), "path")


def _scan(report: robot.ScannerData, time: Timestamp) -> Iterator[View]:
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


def _battery(report: robot.Battery, time: Timestamp) -> Iterator[View]:
    text = TextPrimitive(
        pose=pose(0.0, 0.0, 0.0, _TEXT_HEIGHT),
        billboard=True,
        font_size=14,
        scale_invariant=True,
        color=Color(r=0.2, g=0.6, b=0.2, a=1.0),
        text=f"{report.power} %" + (", charging" if is_charging(report) else ""),
    )
    yield _on_robot("battery", time, texts=[text])


def _outline(report: robot.Model, time: Timestamp) -> Iterator[View]:
    line = LinePrimitive(
        type=LinePrimitive.LINE_LOOP,
        pose=pose(0.0, 0.0, 0.0),
        thickness=0.03,
        points=[Point3(x=corner.x, y=corner.y) for corner in report.model],
        color=Color(r=0.1, g=0.4, b=0.9, a=1.0),
    )
    yield _on_robot("outline", time, lines=[line])


def _on_robot(name: str, time: Timestamp, **primitives: Any) -> View:
    """Return a view that moves with the robot and replaces the earlier view of the same name."""
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


_VIEWS: dict[type[Message], Callable[[Any, Timestamp], Iterator[View]]] = {
    robot.Battery: _battery,
    robot.Model: _outline,
    robot.NavPath: _path,
    robot.PoseSpeed: _pose_speed,
    robot.ScannerData: _scan,
    StatusCode: _status_code,
}


_GRID = protobuf_channel("/view/map", Grid)
_COLOURS = ("red", "green", "blue", "alpha")
"""Fields of a cell: with these names, viewers show the colours without configuration."""
_MAX_CELLS = 9_000_000
"""Size of a map above which it gets no view, in cells: compressing it would delay the recording."""


class FoundMap(NamedTuple):
    """A map in a message of the chassis.

    Attributes:
        area: the map.
        is_saved: False for a map that the robot is making.
        is_current: True for the map that the robot uses or is making. While it is unknown which one
            it uses, True for the only map of a scene.
    """

    area: SceneData.Map
    is_saved: bool
    is_current: bool


class PreparedMap(NamedTuple):
    """A map as it is written: files for map_server, which are attached, and a view.

    Attributes:
        files: contents of the files for map_server, by name; empty if the map is not saved yet.
        view: view of the map; None if it is not the current one, or too large.
    """

    name: str
    files: dict[str, bytes]
    view: View | None

    def attachments(self) -> Iterator[tuple[str, str, bytes]]:
        """Yield name, media type and content of the attachments."""
        for name, content in self.files.items():
            yield name, "image/png" if name.endswith(".png") else "application/yaml", content


class MapFinder:
    """Finds maps in the messages of the chassis."""

    def __init__(self) -> None:
        self._current = robot.Scene()
        """The current scene and map; empty if unknown."""

    def maps_in(self, message: Message) -> Iterator[FoundMap]:
        """Yield the maps in a message; remember which map is the current one."""
        if isinstance(message, robot.RobotInfo) and message.HasField("scene"):
            message = message.scene
        if isinstance(message, robot.Scene):
            self._current = message
        elif isinstance(message, BuildMapData):
            area = SceneData.Map(
                name="in the making", map_png=message.map_data, resolution=message.resolution
            )
            area.origin.x, area.origin.y = message.origin_x, message.origin_y
            yield FoundMap(area, is_saved=False, is_current=True)
        elif isinstance(message, SceneData):
            current = self._current_map(message)
            for area in message.maps:
                if area.map_png:
                    yield FoundMap(area, is_saved=True, is_current=area is current)

    def _current_map(self, data: SceneData) -> SceneData.Map | None:
        """Return the current map if `data` has it; its only map while none is known as current."""
        current = self._current
        if not current.scene_name:
            return data.maps[0] if len(data.maps) == 1 else None
        if data.name not in ("", current.scene_name):
            return None
        try:
            return maps.find_map(data, current.map_id, current.map_name)
        except maps.MapError:
            return None


def prepare_map(found: FoundMap, time: int) -> PreparedMap | None:
    """Return the files and the view of a map; log a map that is not usable, and return None.

    Decoding a large image takes long: call it in a thread of its own. `time` is the Unix time of
    recording, in ns.
    """
    area = found.area
    try:
        maps.check_resolution_and_origin(
            area.resolution, area.origin.x, area.origin.y, area.origin.theta
        )
        stem = re.sub(r"[^\w.-]", "_", area.name)
        files = maps.map_files(area, area.map_png, stem) if found.is_saved else {}
        return PreparedMap(area.name, files, _view(area, time) if found.is_current else None)
    except maps.MapError as error:
        _LOG.warning("map %s is left out: %s", area.name, error)
        return None


def _view(area: SceneData.Map, time: int) -> View | None:
    """Return the view of a map; None if the map is too large."""
    from PIL import ImageOps

    grey = maps.grey_image(area.map_png)
    if grey.width * grey.height > _MAX_CELLS:
        _LOG.warning("map %s is too large for a view; it is attached only", area.name)
        return None
    # the first row of a Grid is the lowest one
    colours = ImageOps.flip(grey).convert("RGBA").tobytes()
    fields = [
        PackedElementField(name=name, offset=offset, type=PackedElementField.UINT8)
        for offset, name in enumerate(_COLOURS)
    ]
    grid = Grid(
        timestamp=timestamp(time),
        frame_id=MAP_FRAME,
        pose=pose(area.origin.x, area.origin.y, area.origin.theta),
        column_count=grey.width,
        cell_size=Vector2(x=area.resolution, y=area.resolution),
        row_stride=len(_COLOURS) * grey.width,
        cell_stride=len(_COLOURS),
        fields=fields,
        data=colours,
    )
    return View(_GRID, grid)
