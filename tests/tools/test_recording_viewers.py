"""What other programs find in a recording: the file is read with the public libraries alone."""

from __future__ import annotations

import contextlib
import io
import json
import math
import random
import subprocess
import sys
import time
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel as McapChannel
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image

from tests.asynchronous import eventually
from tests.quick_chassis import quick_config
from tests.tools.connections import connected
from tests.tools.recordings import add_numbered, recording, writer
from woosh_robot_agent.link.codecs import JSON
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import (
    Battery,
    General,
    Model,
    NavPath,
    PoseSpeed,
    RobotInfo,
    ScannerData,
    Scene,
)
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.simulator import SimulatedChassis
from woosh_robot_agent.tools.recording.reader import read_recording
from woosh_robot_agent.tools.recording.writer import RecordingWriter

EXAMPLE = """
import runpy, sys
example = runpy.run_path(sys.argv[1])
found = example["read"](sys.argv[2])
print(*found)
(_, scan), = found["/view/scan"]
(_, pose), = found["/view/pose"]
print(*example["laser_points"](scan, pose.pose), sep="\\n")
assert not [name for name in sys.modules if name.startswith("woosh")]
"""
"""Reads a recording with the example of the docs, without drawing it."""
DOCS = Path(__file__).parents[2] / "docs"


def decoded(path: Path, topic: str) -> list[Any]:
    """Return the messages on a topic, with their schemas and times."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return list(reader.iter_decoded_messages([topic]))


def in_recording(path: Path, topic: str) -> list[Any]:
    return [each.decoded_message for each in decoded(path, topic)]


def add_pushes(file: RecordingWriter, *messages: Any, sent: int = 0) -> None:
    for message in messages:
        frame = str(JSON.encode(message.DESCRIPTOR.full_name, message, timestamp=sent))
        file.add_frame(1, "chassis", frame.encode(), text=True)


def written(path: Path, *messages: Any, sent: int = 0) -> Path:
    """Write pushes of the chassis into a new recording."""
    file = writer(path)
    add_pushes(file, *messages, sent=sent)
    file.close()
    assert file.lost == 0
    return path


def as_png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return buffer.getvalue()


def png(width: int, height: int) -> bytes:
    image = Image.new("L", (width, height), 254)
    image.putpixel((0, height - 1), 0)  # bottom left
    return as_png(image)


def test_the_documented_example_reads_a_recording(tmp_path):
    at = PoseSpeed()
    at.pose.x, at.pose.y, at.pose.theta = 1.0, 2.0, math.pi / 2
    scan = ScannerData(ranges=[3.0, 99.0], angle_increment=0.1, angle_max=0.1, range_max=10)
    scan.offset.x = 0.25
    path = written(tmp_path / "a.mcap", at, scan)
    done = subprocess.run(
        [sys.executable, "-I", "-c", EXAMPLE, str(DOCS / "plot_recording.py"), str(path)],
        capture_output=True,
        text=True,
        check=True,
    )
    topics, x, y = done.stdout.splitlines()
    assert "/chassis/robot/PoseSpeed" in topics
    assert json.loads(x) == pytest.approx([1.0])  # only the beam that hit something
    assert json.loads(y) == pytest.approx([5.25])


async def test_each_type_and_direction_has_a_channel(tmp_path):
    path = tmp_path / "a.mcap"
    async with (
        SimulatedChassis(quick_config(port=0, tcp_port=0, speed=50, seed=1)) as chassis,
        recording(path, chassis.port) as port,
        connected(port) as (client, pushes),
    ):
        for cls in (PoseSpeed, ScannerData, NavPath):
            client.subscribe(cls, pushes.append)
        assert (await client.request(ExecTask(task_id=7, type=task.kPick, mark_no="A2"))).ok
        scene = (await client.request(RobotInfo())).body.scene
        assert (await client.request(SceneData(name=scene.scene_name))).ok
        assert not (await client.request(ExecTask(task_id=8, mark_no="nowhere"))).ok
        await eventually(
            lambda: any(getattr(each, "state", 0) == task.kCompleted for each in pushes)
        )
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        schemas = {
            each.topic: summary.schemas[each.schema_id] for each in summary.channels.values()
        }
        messages: dict[str, list[Any]] = {}
        for each in reader.iter_decoded_messages():
            messages.setdefault(each.channel.topic, []).append(each.decoded_message)
        metadata = {each.name: each.metadata for each in reader.iter_metadata()}
        attachments = {each.name: each.data for each in reader.iter_attachments()}
    assert schemas["/client/robot/ExecTask"].name == "woosh.robot.ExecTask"
    assert schemas["/chassis/robot/TaskProc"].encoding == "protobuf"
    assert [each.task_id for each in messages["/client/robot/ExecTask"]] == [7, 8]
    assert len(messages["/chassis/robot/ExecTask"]) == 1  # a refusal has no content
    assert messages["/chassis/robot/TaskProc"][-1].robot_task_id == 7
    # What is to look at agrees with what the robot reported.
    assert schemas["/view/pose"].name == "foxglove.PoseInFrame"
    assert schemas["/view/tf"].name == "foxglove.FrameTransform"
    assert schemas["/view/path"].name == "foxglove.PosesInFrame"
    assert schemas["/view/map"].name == "foxglove.Grid"
    assert schemas["/view/scan"].name == "foxglove.LaserScan"
    last = messages["/chassis/robot/PoseSpeed"][-1].pose
    shown = messages["/view/pose"][-1].pose.position
    assert (shown.x, shown.y) == (last.x, last.y)
    moved = messages["/view/tf"][-1]
    assert (moved.parent_frame_id, moved.child_frame_id) == ("map", "base_link")
    assert (moved.translation.x, moved.translation.y) == (last.x, last.y)
    assert "%" in messages["/view/robot"][0].entities[0].texts[0].text
    # Who and where
    assert metadata["woosh_robot_agent"]["address"] == "ws://robot:5480"
    assert metadata["robot"]["serial_number"] == "30001"
    assert metadata["robot"]["software"]
    # The map as map_server loads it
    (description,) = (yaml.safe_load(attachments[name]) for name in attachments if "yaml" in name)
    with Image.open(io.BytesIO(attachments[description["image"]])) as image:
        grid = messages["/view/map"][0]
        assert (image.width, image.height) == (
            grid.column_count,
            len(grid.data) // grid.row_stride,
        )
        assert round(grid.cell_size.x, 6) == description["resolution"]


class FinishingFuture(Future[Any]):
    """A future that is done from the second question on."""

    asked = 0

    def done(self) -> bool:
        self.asked += 1
        return self.asked > 1


class ImmediateWorker:
    """Does the work at once, but says so later."""

    def __init__(self, *arguments: Any, **options: Any) -> None: ...

    def submit(self, work: Any, *arguments: Any) -> Future[Any]:
        future = FinishingFuture()
        future.set_result(work(*arguments))
        return future

    def shutdown(self) -> None: ...


def test_a_map_that_is_prepared_just_now_is_not_lost(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "woosh_robot_agent.tools.recording.writer.ThreadPoolExecutor", ImmediateWorker
    )
    path = tmp_path / "a.mcap"
    file = writer(path)
    data = SceneData(name="hall")
    data.maps.add(name="a", id=3, resolution=0.5, map_png=png(4, 2))
    add_pushes(file, data)
    file.flush()
    file.close()
    assert len(in_recording(path, "/view/map")) == 1


def test_the_map_lies_where_the_robot_says(tmp_path):
    data = SceneData(name="hall")
    area = data.maps.add(name="a/b", id=3, resolution=0.5, map_png=png(4, 2))
    area.origin.x, area.origin.y = -1.0, 2.0
    (grid,) = in_recording(written(tmp_path / "a.mcap", data), "/view/map")
    assert (grid.frame_id, grid.column_count, grid.cell_size.x) == ("map", 4, 0.5)
    assert (grid.pose.position.x, grid.pose.position.y) == (-1.0, 2.0)
    assert [field.name for field in grid.fields] == ["red", "green", "blue", "alpha"]
    assert len(grid.data) == 4 * 2 * 4
    assert list(grid.data[:8]) == [0, 0, 0, 255, 254, 254, 254, 255]  # begins bottom left
    with (tmp_path / "a.mcap").open("rb") as file:
        names = [each.name for each in make_reader(file).iter_attachments()]
    assert sorted(names) == ["a_b.png", "a_b.yaml"]


def test_a_map_of_another_scene_is_not_shown(tmp_path):
    for fetched in ("hall", "other"):
        data = SceneData(name=fetched)
        data.maps.add(name="a", id=3, resolution=0.5, map_png=png(4, 2))
        scene = Scene(scene_name="hall", map_id=3, map_name="a")
        shown = in_recording(written(tmp_path / f"{fetched}.mcap", scene, data), "/view/map")
        assert len(shown) == (fetched == "hall")


def test_views_show_what_was_reported(tmp_path):
    path = NavPath()
    path.path.poses.add(x=1.0, y=2.0)
    scan = ScannerData(angle_min=-1.0, angle_max=1.0, range_min=0.1, range_max=5.0)
    scan.ranges.extend([0.0, 1.5, 9.0])
    scan.offset.x = 0.25
    code = StatusCode(code=1, msg="bumped", level=StatusCode.kFault)
    battery = Battery(power=76, charge_state=Battery.kAuto)
    general = General(serial_number=7, display_model="TR200")
    sent = 1_700_000_000_123
    # a report without the robot's number does not replace that
    reports = [path, scan, code, general, RobotInfo(battery=Battery(power=5)), battery]
    file = written(tmp_path / "a.mcap", *reports, sent=sent)
    ((schema, _, message, reported),) = decoded(file, "/chassis/robot/NavPath")
    assert (schema.name, reported.path.poses[0].y) == ("woosh.robot.NavPath", 2.0)
    assert message.publish_time == sent * 1_000_000
    assert abs(message.log_time / 1e9 - time.time()) < 3600  # ours, not the robot's
    (shown,) = in_recording(file, "/view/path")
    assert [(each.position.x, each.position.y) for each in shown.poses] == [(1.0, 2.0)]
    (laser,) = in_recording(file, "/view/scan")
    assert list(laser.ranges) == [float("inf"), 1.5, float("inf")]
    assert (laser.pose.position.x, laser.start_angle, laser.end_angle) == (0.25, -1.0, 1.0)
    (log,) = in_recording(file, "/view/status_codes")
    assert ("bumped" in log.message, log.level) == (True, 4)
    *_, last = in_recording(file, "/view/robot")
    assert last.entities[0].texts[0].text == "76 %, charging"
    with file.open("rb") as stream:
        records = list(make_reader(stream).iter_metadata())
    numbers = [each.metadata["serial_number"] for each in records if each.name == "robot"]
    assert numbers == ["7"]


def test_fast_reports_are_recorded_all_and_shown_at_an_eyes_rate(tmp_path):
    reports = []
    for number in range(500):
        report = PoseSpeed(map_id=1)
        report.pose.x = number
        reports.append(report)
    path = written(tmp_path / "a.mcap", *reports)
    assert [m.pose.x for m in in_recording(path, "/chassis/robot/PoseSpeed")] == list(range(500))
    shown = [message.pose.position.x for message in in_recording(path, "/view/pose")]
    assert len(shown) < 500
    assert shown[-1] == 499


def test_every_file_of_a_split_recording_has_robot_and_map(tmp_path):
    data = SceneData(name="hall")
    data.maps.add(name="a", id=3, resolution=0.5, map_png=png(4, 2))
    info, at, outline = RobotInfo(), PoseSpeed(), Model()
    info.genral.serial_number = 5
    at.pose.x = 4.0
    outline.model.add(x=1.0, y=2.0)
    file = writer(tmp_path / "a.mcap", split_size=100_000)
    add_pushes(file, info, data, at, outline, Battery(power=50))
    while "/view/map" not in topics_in(file.files.paths[0]):  # the map is prepared in a thread
        file.flush()
    add_numbered(file, 3000)
    file.close()
    assert len(file.files.paths) > 1
    for path in file.files.paths[1:]:
        with path.open("rb") as stream:
            reader = make_reader(stream)
            assert {each.name for each in reader.iter_metadata()} == {"woosh_robot_agent", "robot"}
            assert {each.name for each in reader.iter_attachments()} == {"a.png", "a.yaml"}
        assert len(in_recording(path, "/view/map")) == 1
        # a robot that stands still reports nothing of this again
        assert [view.translation.x for view in in_recording(path, "/view/tf")] == [4.0]
        shown = in_recording(path, "/view/robot")
        assert {each.id for view in shown for each in view.entities} == {"outline", "battery"}


def test_a_map_larger_than_the_split_size_leaves_room_for_messages(tmp_path):
    data = SceneData(name="hall")
    noise = Image.frombytes("L", (200, 200), random.Random(1).randbytes(200 * 200))
    data.maps.add(name="a", id=3, resolution=0.5, map_png=as_png(noise))
    file = writer(tmp_path / "a.mcap", split_size=20_000)
    add_pushes(file, data)
    # the map is prepared in a thread
    while not any("/view/map" in topics_in(path) for path in file.files.paths):
        file.flush()
    add_numbered(file, 1000)
    file.close()
    assert len(file.files.paths) < 10
    assert file.lost == 0


def test_frames_that_cannot_be_decoded_are_recorded_as_they_are(tmp_path):
    path = tmp_path / "a.mcap"
    file = writer(path)
    frames = [
        b"{no json",
        b'{"type":"woosh.robot.Mode","body":5}',
        b'{"type":"no.such.Type","body":{}}',
        b'{"type":"woosh.robot.PoseSpeed","body":{"pose":{"x":"NaN"}},"timestamp":-5}',
        b'{"type":"woosh.robot.Mode","body":{"work":1},"timestamp":1e300}',
        b'{"type":"woosh.map.SceneData","body":{"maps":[{"mapPng":"AAAA","resolution":0.1}]}}',
    ]
    for frame in frames:
        file.add_frame(1, "chassis", frame, text=True)
    file.close()
    assert (file.frames, file.lost) == (len(frames), 0)
    assert [each.data.encode() for each in read_recording(path).records] == frames  # type: ignore[union-attr]
    assert in_recording(path, "/view/pose") == []


def topics_in(path: Path) -> list[str]:
    """Return the topics in a file without an end."""
    topics = []
    with path.open("rb") as file, contextlib.suppress(EndOfFile):
        for each in StreamReader(file).records:
            if isinstance(each, McapChannel):
                topics.append(each.topic)
    return topics
