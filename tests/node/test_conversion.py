"""Conversion between ROS, protobuf and the wire is exact in both directions for every type."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from tests.random_messages import carried, random_proto, random_ros
from tests.type_pairs import PAIRS
from woosh_common_msgs.msg import Pose2D
from woosh_nav_msgs.msg import Path, PlanPath
from woosh_robot_agent.convert import BadFieldError, converter
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_msgs.msg import ChangeNavPath, ExecTask, PoseSpeed, ScannerData, Speak
from woosh_ros_msgs.msg import CallAction, MoveBase

# the only oneof with message members; the table lacks it, because the agent converts its members
PAIRS = PAIRS | {"woosh.ros.CallAction": (CallAction, message_type("woosh.ros.CallAction"))}
CODECS = {
    "json": JsonCodec(),
    "json of a chassis": JsonCodec(defaults=True),
    "binary": ProtobufCodec(),
}
EXAMPLES = int(os.environ.get("CONVERSION_EXAMPLES", "15"))

# hypothesis draws only a seed: messages drawn value by value would be too large for it
some = settings(
    max_examples=EXAMPLES,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    derandomize=True,
)
seeds = st.integers(0, 2**63)


def over_the_wire(message: Any, codec: Any) -> Any:
    name = full_name(message)
    return codec.body(codec.decode(codec.encode(name, message, sn=1, ok=True)), type(message))


def over_dds(message: Any) -> Any:
    return deserialize_message(serialize_message(message), type(message))


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
class TestRoundTrip:
    @some
    @given(seed=seeds)
    def test_ros_to_protobuf_and_back(self, pair: Any, seed: int):
        convert = converter(*pair)
        ros = random_ros(random.Random(seed), pair[0])
        wanted = carried(ros)
        for codec in CODECS.values():
            back = convert.to_ros(over_the_wire(convert.to_proto(over_dds(ros)), codec))
            assert back == wanted
            assert repr(back) == repr(wanted)  # distinguishes -0.0 from 0.0

    @some
    @given(seed=seeds)
    def test_protobuf_to_ros_and_back(self, pair: Any, seed: int):
        convert = converter(*pair)
        message = random_proto(random.Random(seed), pair[1], pair[0])
        for codec in CODECS.values():
            back = convert.to_proto(over_dds(convert.to_ros(over_the_wire(message, codec))))
            assert back == message
            assert back.SerializeToString() == message.SerializeToString()


@pytest.mark.timeout(600)
def test_messages_pass_the_field_checks_of_ros():
    """ROS checks each assignment to a field if ROS_PYTHON_CHECK_FIELDS is set at start-up."""
    env = os.environ | {"ROS_PYTHON_CHECK_FIELDS": "1", "CONVERSION_EXAMPLES": "2"}
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-k",
        "TestRoundTrip",
    ]
    done = subprocess.run(
        [*command, __file__], env=env, capture_output=True, text=True, timeout=500
    )
    assert done.returncode == 0, done.stdout
    assert f"{2 * len(PAIRS)} passed" in done.stdout


def test_nan_is_converted_to_ros():
    """A scanner reports NaN without a reflection; only numbers sent to the robot must be finite."""
    frame = {"type": "woosh.robot.ScannerData", "body": {"ranges": ["NaN", "Infinity", 1.5]}}
    codec = JsonCodec()
    body = codec.body(codec.decode(json.dumps(frame)), message_type("woosh.robot.ScannerData"))
    ranges = converter(ScannerData, type(body)).to_ros(body).ranges
    assert str(list(ranges)) == "[nan, inf, 1.5]"


def test_fields_of_a_newer_chassis_are_ignored():
    proto = message_type("woosh.robot.ScannerData")(angle_min=1.0)
    proto.offset.x = 2.0
    assert converter(ScannerData, type(proto)).to_ros(proto).angle_min == 1.0
    assert "offset" not in ScannerData.get_fields_and_field_types()


class TestBadValues:
    """Values that must not be sent to the robot are refused with the path of their field."""

    @pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
    def test_non_finite_number_is_refused(self, value: float):
        ros = MoveBase(poses=[Pose2D(), Pose2D(theta=value)])
        self._refused(ros, "poses[1].theta")

    def test_number_in_an_array_is_refused(self):
        self._refused(ScannerData(ranges=[0.0, float("nan")]), "ranges[1]")

    def test_number_in_nested_lists_is_refused(self):
        ros = ChangeNavPath()
        ros.paths.plan_path.append(PlanPath(path=Path(poses=[Pose2D(x=float("inf"))])))
        self._refused(ros, "paths.plan_path[0].path.poses[0].x")

    @pytest.mark.parametrize("text", [b"a\xff".decode(errors="surrogateescape"), chr(0xD800)])
    def test_invalid_text_is_refused(self, text: str):
        self._refused(Speak(text=text), "text")

    def test_absent_fields_are_not_checked(self):
        ros = PoseSpeed(has_field=PoseSpeed.TWIST_FIELD_SET)
        ros.pose.x = float("nan")
        assert not convert_of(ros).to_proto(ros).HasField("pose")

    def test_unknown_member_of_a_oneof_is_refused(self):
        ros = PoseSpeed()
        ros.commu.which = 2
        self._refused(ros, "commu.which")

    def _refused(self, ros: Any, path: str) -> None:
        with pytest.raises(BadFieldError) as caught:
            convert_of(ros).to_proto(ros)
        assert caught.value.path == path
        assert str(caught.value.below("arg")).startswith(f"arg.{path}: ")


def convert_of(ros: Any) -> Any:
    return next(converter(*pair) for pair in PAIRS.values() if pair[0] is type(ros))


def test_bytes_of_any_value_are_sent():
    ros = ExecTask(custom=bytes(range(256)))
    assert convert_of(ros).to_proto(ros).custom == bytes(range(256))
