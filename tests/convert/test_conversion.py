"""Conversion between ROS, protobuf and JSON is exact in both directions for every type."""

from __future__ import annotations

import copy
import json
import math
import os
import pathlib
import random
import subprocess
import sys
from typing import Any

import pytest
from rclpy.serialization import deserialize_message, serialize_message

from tests.convert.random_messages import carried, random_proto, random_ros
from tests.convert.type_pairs import PAIRS
from woosh_common_msgs.msg import Pose2D
from woosh_map_msgs.msg import SceneDataEasy
from woosh_nav_msgs.msg import Path, PlanPath
from woosh_robot_agent.convert import BadFieldError, converter
from woosh_robot_agent.convert.converter import Converter
from woosh_robot_agent.link.codecs.json_codec import JsonCodec, from_json, to_json
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.frames import FieldError
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_msgs.msg import ChangeNavPath, PoseSpeed, ScannerData, Speak
from woosh_robot_msgs.msg import PlanPath as PlanPaths
from woosh_ros_msgs.msg import CallAction, MoveBase

# the only oneof with message members; the table lacks it, because the agent converts its members
PAIRS = PAIRS | {"woosh.ros.CallAction": (CallAction, message_type("woosh.ros.CallAction"))}
CODECS = {
    "json": JsonCodec(),
    "json of a chassis": JsonCodec(defaults=True),
    "binary": ProtobufCodec(),
}
ROUNDS = 4
ODD = [
    *(None, True, False, 0, 1, -1, 1.0, 0.5, -0.0, 2**31, 2**63, 2**64, 10**40, 10**400, 1e39),
    *(math.nan, math.inf, "NaN", "-Infinity", "12", "-3", "1e3", "1.5", "true", "false", ""),
    *("kNormal", "kIdle", "kNoSuchName", "\ud800", "机器人", "AAEC", "-_8", "not base64!", [], {}),
    *([None], [1, None, 2.5], [{}, None], [True], ["x"], [[]], {"x": 1}, {"value": 3}),
]


def over_the_wire(message: Any, codec: Any) -> Any:
    name = full_name(message)
    return codec.body(codec.decode(codec.encode(name, message, sn=1, ok=True)), type(message))


def over_dds(message: Any) -> Any:
    return deserialize_message(serialize_message(message), type(message))


def outcome(read: Any) -> tuple[str, object]:
    """Return the result of a conversion: the message as ROS sends it, or the bad field and why."""
    try:
        # numbers as ROS sends them; repr() distinguishes -0.0 from 0.0, and NaN equals NaN
        return "message", repr(over_dds(read()))
    except FieldError as error:
        return "refused", (error.path, error.reason)


def both_ways(convert: Converter, data: object) -> tuple[Any, Any]:
    """Return the results of the direct conversion and of the one through protobuf."""

    def by_protobuf() -> Any:
        message = convert.proto_class()
        from_json(data, message)
        return convert.to_ros(message)

    return outcome(lambda: convert.from_json(data)), outcome(by_protobuf)


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
class TestRoundTrip:
    def test_ros_to_protobuf_and_back(self, pair: Any):
        convert = converter(*pair)
        for seed in range(ROUNDS):
            ros = random_ros(random.Random(seed), pair[0])
            wanted = carried(ros)
            for codec in CODECS.values():
                back = convert.to_ros(over_the_wire(convert.to_proto(over_dds(ros)), codec))
                assert back == wanted
                assert repr(back) == repr(wanted)  # distinguishes -0.0 from 0.0

    def test_protobuf_to_ros_and_back(self, pair: Any):
        convert = converter(*pair)
        for seed in range(ROUNDS):
            message = random_proto(random.Random(seed), pair[1], pair[0])
            for codec in CODECS.values():
                back = convert.to_proto(over_dds(convert.to_ros(over_the_wire(message, codec))))
                assert back == message
                assert back.SerializeToString() == message.SerializeToString()


def check_random_json_of_each_type() -> None:
    for ros_class, proto_class in PAIRS.values():
        message = random_proto(random.Random(0), proto_class, ros_class)
        at_once, by_protobuf = both_ways(
            converter(ros_class, proto_class), to_json(message, defaults=True)
        )
        assert at_once[0] == "message"
        assert at_once == by_protobuf


def test_messages_pass_the_field_checks_of_ros():
    """ROS checks each assignment to a field if ROS_PYTHON_CHECK_FIELDS is set at start-up."""
    program = f"import {__name__} as tests; tests.{check_random_json_of_each_type.__name__}()"
    env = os.environ | {"ROS_PYTHON_CHECK_FIELDS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=pathlib.Path(__file__).parents[2],
        env=env,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", PAIRS)
def test_any_message_and_one_with_an_unusual_value(name: str):
    """JSON that is converted directly gives the same as through protobuf, refusals included."""
    convert = converter(*PAIRS[name])
    for seed in range(2 * ROUNDS):
        rng = random.Random(seed)
        message = random_proto(rng, convert.proto_class, convert.ros_class)
        # short, or as a chassis writes it
        data = {"": json.loads(json.dumps(to_json(message, defaults=rng.random() < 0.5)))}
        at_once, by_protobuf = both_ways(convert, data[""])
        assert at_once[0] == "message"
        assert at_once == by_protobuf, data
        for _ in range(rng.randint(1, 3)):
            holder, key = rng.choice(places(data))
            if key in holder if isinstance(holder, dict) else key < len(holder):
                holder[key] = copy.deepcopy(rng.choice(ODD))
        at_once, by_protobuf = both_ways(convert, data[""])
        assert at_once == by_protobuf, data


def places(data: Any) -> list[tuple[Any, Any]]:
    """Return every place in nested JSON, as its container and its key or index."""
    if isinstance(data, dict):
        keys: list[Any] = list(data)
    elif isinstance(data, list):
        keys = list(range(len(data)))
    else:
        return []
    return [(data, key) for key in keys] + [p for key in keys for p in places(data[key])]


@pytest.mark.parametrize(
    "data",
    [
        {"map_id": 3, "pose": {"x": 1}},
        {"mapId": None, "map_id": 3},
        {"mapId": "3", "mileage": 4.0, "twist": None},
        {"later": {"than": ["this"]}, "pose": {"x": "NaN", "y": math.inf}},
        {"robotId": 7},
        {"robot_id": 0},
        {},
    ],
)
def test_values_of_older_and_newer_chassis_are_accepted(data: Any):
    at_once, by_protobuf = both_ways(converter(*PAIRS["woosh.robot.PoseSpeed"]), data)
    assert at_once == by_protobuf
    assert at_once[0] == "message"


def test_ranges_without_a_reflection_become_nan():
    data = {"ranges": [1, None, 2.5, "NaN", "Infinity"]}
    ranges = converter(*PAIRS["woosh.robot.ScannerData"]).from_json(data).ranges
    assert str(list(ranges)) == "[1.0, nan, 2.5, nan, inf]"


def test_messages_share_nothing():
    """A node may modify a message that it has received."""
    convert = converter(*PAIRS["woosh.robot.RobotInfo"])
    first = convert.from_json({})
    first.pose_speed.pose.x = 1.0
    first.abnormal_codes.scs.append("something")
    second = convert.from_json({})
    assert (second.pose_speed.pose.x, second.abnormal_codes.scs) == (0.0, [])


def test_a_class_with_other_slots_is_created_by_its_constructor():
    """ROS does not guarantee the slots. The agent must work with other releases too, if slower."""
    original = PAIRS["woosh.robot.PoseSpeed"][0]

    class Later(original):  # type: ignore[misc, valid-type]
        __slots__ = ("_later",)

    data = {"pose": {"x": 1.5}, "mapId": 3}
    made = Converter(Later, message_type("woosh.robot.PoseSpeed")).from_json(data)
    assert (made.pose.x, made.map_id) == (1.5, 3)
    assert made.has_field == Later.POSE_FIELD_SET


def test_a_class_that_does_not_mirror_the_message_is_refused():
    with pytest.raises(TypeError, match="lacks the oneof"):
        Converter(SceneDataEasy, message_type("woosh.robot.PoseSpeed"))


def test_fields_of_a_newer_chassis_are_ignored():
    proto = message_type("woosh.robot.ScannerData")(angle_min=1.0)
    proto.offset.x = 2.0
    assert converter(ScannerData, type(proto)).to_ros(proto).angle_min == 1.0
    assert "offset" not in ScannerData.get_fields_and_field_types()


PATHS = PlanPaths(plan_path=[PlanPath(path=Path(poses=[Pose2D(x=math.inf)]))])


@pytest.mark.parametrize(
    ("ros", "path"),
    [
        *(
            (MoveBase(poses=[Pose2D(), Pose2D(theta=value)]), "poses[1].theta")
            for value in (math.nan, math.inf, -math.inf)
        ),
        (ScannerData(ranges=[0.0, math.nan]), "ranges[1]"),
        (ChangeNavPath(paths=PATHS), "paths.plan_path[0].path.poses[0].x"),
        (Speak(text=b"a\xff".decode(errors="surrogateescape")), "text"),
        (Speak(text=chr(0xD800)), "text"),
        (PoseSpeed(commu=type(PoseSpeed().commu)(which=2)), "commu.which"),
    ],
)
def test_a_value_that_must_not_be_sent_to_the_robot_is_refused(ros: Any, path: str) -> None:
    with pytest.raises(BadFieldError) as caught:
        convert_of(ros).to_proto(ros)
    assert caught.value.path == path
    assert str(caught.value.below("arg")).startswith(f"arg.{path}: ")


def test_absent_fields_are_not_checked():
    ros = PoseSpeed(has_field=PoseSpeed.TWIST_FIELD_SET)
    ros.pose.x = math.nan
    assert not convert_of(ros).to_proto(ros).HasField("pose")


def convert_of(ros: Any) -> Any:
    return next(converter(*pair) for pair in PAIRS.values() if pair[0] is type(ros))
