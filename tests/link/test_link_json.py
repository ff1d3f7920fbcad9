"""JSON frames as they are on the wire, compared with literal text in both directions."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from woosh_robot_agent.link.codecs.json_codec import JsonCodec, from_json, to_json
from woosh_robot_agent.link.frames import FieldError, FrameError
from woosh_robot_agent.pb.dispatch import robot_pb2 as dispatch
from woosh_robot_agent.pb.dispatch.robot_pb2 import RobotAnyInfo
from woosh_robot_agent.pb.robot.robot_pack_pb2 import (
    SetOccupancy,
    SwitchControlMode,
)
from woosh_robot_agent.pb.robot.robot_pb2 import (
    HardwareState,
    Mode,
    Network,
    PoseSpeed,
    RobotInfo,
    ScannerData,
    Scene,
    TaskProc,
)
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription

CODEC = JsonCodec()

POSE_REQUEST = '{"type":"woosh.robot.PoseSpeed","body":{},"sn":7,"timestamp":1700000000000}'
POSE_ANSWER = (
    '{"type":"woosh.robot.PoseSpeed","body":{"robotId":30001,"twist":{"linear":0.2,"angular":0},'
    '"pose":{"x":-8.881,"y":0.5187,"theta":2.8966},"mapId":0,"mileage":1204},"ok":true,"msg":"",'
    '"sn":7,"timestamp":1700000000012}'
)
SWITCH_REQUEST = (
    '{"type":"woosh.robot.SwitchControlMode","body":{"mode":1},"sn":8,"timestamp":1700000000100}'
)
SWITCH_ANSWER = (
    '{"type":"woosh.robot.Mode","body":{"ctrl":1,"work":2},"ok":true,"msg":"Request succeed",'
    '"sn":8,"timestamp":1700000000104}'
)
SUBSCRIBE = (
    '{"type":"woosh.Subscription","body":{"topics":["woosh.robot.PoseSpeed",'
    '"woosh.robot.TaskProc"],"sub":true}}'
)
TASK_PUSH = (
    '{"type":"woosh.robot.TaskProc","body":{"robotTaskId":"68241434201","type":1,"state":3,'
    '"action":{"type":1,"state":1,"waitId":0},"dest":"K10","msg":"","time":1682416646}}'
)
FAILED = '{"type":"error","body":{},"ok":false,"msg":"robot is not initialised","sn":9}'
FRAMES = (
    *(POSE_REQUEST, POSE_ANSWER, SWITCH_REQUEST, SWITCH_ANSWER),
    *(SUBSCRIBE, TASK_PUSH, FAILED),
)


def body(data: Any, message: Any) -> Any:
    from_json(data, message)
    return message


# Writing


def test_a_request_as_on_the_wire() -> None:
    written = CODEC.encode("woosh.robot.PoseSpeed", PoseSpeed(), sn=7, timestamp=1700000000000)
    assert written == POSE_REQUEST
    switch = SwitchControlMode(mode=1)  # type: ignore[arg-type]
    written = CODEC.encode("woosh.robot.SwitchControlMode", switch, sn=8, timestamp=1700000000100)
    assert written == SWITCH_REQUEST


def test_a_subscription_as_on_the_wire() -> None:
    topics = ["woosh.robot.PoseSpeed", "woosh.robot.TaskProc"]
    written = CODEC.encode("woosh.Subscription", Subscription(topics=topics, sub=True))
    assert json.loads(written) == json.loads(SUBSCRIBE)


@pytest.mark.parametrize(
    ("message", "written"),
    [
        (TaskProc(robot_task_id=68241434201, state=3), {"robotTaskId": "68241434201", "state": 3}),
        (Scene(version=-5, map_name="m"), {"version": "-5", "mapName": "m"}),
        (Network.WiFi(code=2**64 - 1), {"code": "18446744073709551615"}),
        (Network.WiFi(list_json=b"\xff\x00"), {"listJson": "/wA="}),
        (HardwareState(motor=[1, 17], seanner=1), {"motor": [1, 17], "seanner": 1}),
        (RobotInfo(genral={"urdf_name": "u"}), {"genral": {"urdfName": "u"}}),
        (
            ScannerData(ranges=[math.nan, math.inf, -math.inf]),
            {"ranges": ["NaN", "Infinity", "-Infinity"]},
        ),
    ],
)
def test_a_message_is_written_as_the_chassis_does(message: Any, written: Any) -> None:
    assert to_json(message, defaults=False) == written
    assert json.loads(CODEC.encode("t", message))["body"] == written


def test_floats_are_written_short_and_exact() -> None:
    pose = body({"pose": {"x": -8.881, "y": 1e30, "theta": 0.1}}, PoseSpeed())
    text = CODEC.encode("t", pose)
    assert '"x":-8.881,"y":1e+30,"theta":0.1' in text


def test_text_is_written_as_utf8_and_defaults_on_request() -> None:
    assert to_json(Mode(), defaults=True) == {"ctrl": 0, "work": 0}
    assert "机器人" in CODEC.encode("t", TaskProc(msg="机器人"))


def test_a_foreign_type_in_an_any_is_a_field_error() -> None:
    message = dispatch.DESCRIPTOR.message_types_by_name
    name = next(
        one.full_name
        for one in message.values()
        if any(f.message_type and f.message_type.name == "Any" for f in one.fields)
    )
    holder: Any = getattr(dispatch, name.rpartition(".")[2])()
    holder.info.type_url = "type.googleapis.com/no.such.Type"
    holder.info.value = b"\x08\x01"
    with pytest.raises(FieldError, match=r"no\.such\.Type"):
        to_json(holder, defaults=False)


# Reading


def test_frames_as_on_the_wire() -> None:
    answer = CODEC.decode(POSE_ANSWER)
    assert (answer.type, answer.ok, answer.msg) == ("woosh.robot.PoseSpeed", True, "")
    assert (answer.sn, answer.timestamp) == (7, 1700000000012)
    pose = CODEC.body(answer, PoseSpeed)
    assert (pose.robot_id, pose.mileage, pose.map_id) == (30001, 1204, 0)
    assert pose.pose.x == pytest.approx(-8.881)
    assert pose.twist.linear == pytest.approx(0.2)

    other_type = CODEC.decode(SWITCH_ANSWER)
    assert (other_type.type, other_type.msg) == ("woosh.robot.Mode", "Request succeed")
    assert CODEC.body(other_type, Mode) == Mode(ctrl=1, work=2)  # type: ignore[arg-type]

    push = CODEC.decode(TASK_PUSH)
    assert (push.sn, push.ok, push.timestamp) == (0, None, None)
    task = CODEC.body(push, TaskProc)
    assert (task.robot_task_id, task.state, task.dest) == (68241434201, 3, "K10")
    assert task.action.type == 1

    failed = CODEC.decode(FAILED)
    assert (failed.ok, failed.sn, failed.msg) == (False, 9, "robot is not initialised")


def test_unknown_fields_are_skipped() -> None:
    data = {"mapId": 3, "news": {"a": [1, {"b": None}]}, "pose": {"x": 1, "w": [[]]}}
    pose = body(data, PoseSpeed())
    assert (pose.map_id, pose.pose.x) == (3, 1)
    envelope = CODEC.decode('{"type":"t","extra":{"a":1},"sn":4}')
    assert envelope.sn == 4


@pytest.mark.parametrize(
    ("cls", "data", "field", "value"),
    [
        (TaskProc, {"robot_task_id": "5"}, "robot_task_id", 5),
        (ScannerData, {"angle_min": -2.5}, "angle_min", -2.5),
        *(
            (TaskProc, {"robotTaskId": each}, "robot_task_id", 1000)
            for each in (1000, "1000", 1e3, "1e3", "1000.0")
        ),
        *(
            (TaskProc, {"robotTaskId": each}, "robot_task_id", 2**63 - 1)
            for each in (2**63 - 1, str(2**63 - 1))
        ),
        (PoseSpeed, {"mapId": "7"}, "map_id", 7),
        (Pose2D, {"x": "1.5"}, "x", 1.5),
        *((Mode, {"ctrl": each}, "ctrl", 1) for each in (1, "1", 1.0, "kAuto")),
        (Mode, {"ctrl": 77}, "ctrl", 77),
        (Mode, {"ctrl": "kNewerThanThis"}, "ctrl", 0),
        (HardwareState, {"motor": ["kFatal", "kNewer", 1]}, "motor", [17, 0, 1]),
        *((SetOccupancy, {"occupy": each}, "occupy", True) for each in (True, "true", 1, 1.0)),
        *((SetOccupancy, {"occupy": each}, "occupy", False) for each in (False, "false", 0)),
        *(
            (Network.WiFi, {"listJson": each}, "list_json", b"\xff\x00")
            for each in ("/wA=", "/wA", "_wA=", "_wA")
        ),
    ],
)
def test_each_notation_of_a_value_is_accepted(cls: Any, data: Any, field: str, value: Any) -> None:
    assert getattr(body(data, cls()), field) == value


def test_null_means_the_default() -> None:
    pose = body({"mapId": None, "pose": None, "twist": {"linear": None}}, PoseSpeed())
    assert pose.map_id == 0
    assert not pose.HasField("pose")
    assert pose.HasField("twist")
    assert CODEC.body(CODEC.decode('{"type":"t","body":null}'), PoseSpeed) == PoseSpeed()
    assert CODEC.body(CODEC.decode('{"type":"t"}'), PoseSpeed) == PoseSpeed()


def test_null_in_a_list_does_not_move_the_other_items() -> None:
    ranges = list(body({"ranges": [1.5, None, 2.5]}, ScannerData()).ranges)
    assert math.isnan(ranges.pop(1))
    assert ranges == [1.5, 2.5]
    assert list(body({"motor": [1, None]}, HardwareState()).motor) == [1, 0]
    history = body({"taskHistory": {"tes": [{"time": 1}, None]}}, RobotInfo()).task_history
    assert [task.time for task in history.tes] == [1, 0]
    assert list(body({"topics": ["a", None]}, Subscription()).topics) == ["a", ""]


def test_nan_and_infinity_are_accepted_as_numbers_and_as_text() -> None:
    text = '{"type":"t","body":{"ranges":[NaN,Infinity,-Infinity,"NaN","Infinity","-Infinity"]}}'
    ranges = list(CODEC.body(CODEC.decode(text), ScannerData).ranges)
    assert [math.isnan(value) for value in ranges] == [True, False, False] * 2
    assert ranges[1:3] == ranges[4:6] == [math.inf, -math.inf]


@pytest.mark.parametrize(
    ("cls", "data", "path"),
    [
        (PoseSpeed, {"mapId": 2**32}, "map_id"),
        (PoseSpeed, {"mapId": -1}, "map_id"),
        (PoseSpeed, {"mapId": "9" * 5000}, "map_id"),
        (PoseSpeed, {"mapId": "1e999"}, "map_id"),
        (PoseSpeed, {"mapId": 1.5}, "map_id"),
        (PoseSpeed, {"mapId": True}, "map_id"),
        (PoseSpeed, {"mapId": math.nan}, "map_id"),
        (PoseSpeed, {"mapId": {}}, "map_id"),
        (PoseSpeed, {"pose": {"x": "far"}}, "pose.x"),
        (PoseSpeed, {"pose": {"x": True}}, "pose.x"),
        (PoseSpeed, {"pose": {"x": 10**400}}, "pose.x"),
        (PoseSpeed, {"pose": 3}, "pose"),
        (PoseSpeed, [], ""),
        (TaskProc, {"dest": 5}, "dest"),
        (TaskProc, {"dest": "\ud800"}, "dest"),
        (Mode, {"ctrl": 2**40}, "ctrl"),
        (Mode, {"ctrl": []}, "ctrl"),
        (SetOccupancy, {"occupy": 2}, "occupy"),
        (ScannerData, {"ranges": 1.5}, "ranges"),
        (ScannerData, {"ranges": [1, "x"]}, "ranges[1]"),
        (Network.WiFi, {"listJson": "ä"}, "list_json"),
        (Network.WiFi, {"listJson": "/wA=="[:1]}, "list_json"),
        (RobotInfo, {"taskHistory": {"tes": [{}, {"time": "x"}]}}, "task_history.tes[1].time"),
        (RobotAnyInfo, {"info": {"@type": "type.googleapis.com/\ud800"}}, "info"),
    ],
)
def test_a_value_that_does_not_fit_names_its_field(cls: Any, data: Any, path: str) -> None:
    with pytest.raises(FieldError) as caught:
        from_json(data, cls())
    assert caught.value.path == path
    envelope = CODEC.decode('{"type":"t","sn":1}')
    envelope.body = data
    with pytest.raises(FrameError) as failed:
        CODEC.body(envelope, cls)
    assert failed.value.kind == "body"
    assert str(failed.value).encode(), "the log and ROS messages have the text"


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("", "json"),
        ("{", "json"),
        ("[1]", "envelope"),
        ("null", "envelope"),
        ("{}", "envelope"),
        ('{"type":5}', "envelope"),
        ('{"type":""}', "envelope"),
        ('{"type":"t","sn":"x"}', "envelope"),
        ('{"type":"t","sn":7.5}', "envelope"),
        ('{"type":"t","sn":[]}', "envelope"),
        ('{"type":"t","sn":1e999}', "envelope"),
        ('{"type":"t","sn":"' + "9" * 4000 + '"}', "envelope"),
        ('{"type":"t","sn":"0x10"}', "envelope"),
        ('{"type":"t","body":{"x":' + "9" * 100_000 + "}}", "json"),
        (b"\xff", "utf-8"),
    ],
)
def test_data_that_is_not_a_frame_gives_an_error_of_its_kind(text: str | bytes, kind: str) -> None:
    with pytest.raises(FrameError) as caught:
        CODEC.decode(text)
    assert caught.value.kind == kind
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        *(("sn", each, 7) for each in ("7", 7.0)),
        *(("ok", each, True) for each in (True, 1, "true")),
        ("ok", 0, False),
        *(("timestamp", each, None) for each in ("soon", [], {"a": 1}, True, 1e999, None)),
        *(("msg", each, "") for each in (None, {"a": 1})),
        *(("msg", *each) for each in ((5, "5"), ("机", "机"), ("a\ud800b", "a?b"))),
    ],
)
def test_values_of_the_envelope_are_accepted_in_every_form(
    name: str, value: Any, expected: Any
) -> None:
    found = getattr(CODEC.decode(json.dumps({"type": "t", "sn": 1, name: value})), name)
    assert (type(found), found) == (type(expected), expected)
