"""Both codecs with random messages and data: round trips are exact; bad data gives FrameError."""

from __future__ import annotations

import json
import random
import re
from typing import Any

import pytest
from google.protobuf import json_format
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fact_files import FOLDER
from tests.link.fuzz_inputs import filled
from woosh_robot_agent.link.codecs.json_codec import JsonCodec, from_json
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.frames import FieldError, FrameError
from woosh_robot_agent.link.protos import message_types
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed

TYPES = message_types()
TABLE = sorted(
    TYPES.keys() & re.findall(r"woosh\.[\w.]*\w", (FOLDER / "endpoints.yaml").read_text("utf-8"))
)
"""Full names of all messages in the table of endpoints."""
LARGEST = float.fromhex("0x1.fffffep+127")
CODECS = [JsonCodec(), JsonCodec(defaults=True), ProtobufCodec()]


def raw(message: Any) -> bytes:
    return bytes(message.SerializeToString(deterministic=True))


@pytest.mark.parametrize("codec", CODECS, ids=["json", "json with defaults", "protobuf"])
def test_each_type_survives_a_round_trip(codec: Any) -> None:
    for name, cls in TYPES.items():
        for seed in range(4 if name in TABLE else 1):
            message = filled(random.Random(seed), cls)
            data = codec.encode(name, message, sn=5, ok=True, msg="ü", timestamp=6)
            envelope = codec.decode(data)
            assert (envelope.type, envelope.sn, envelope.ok, envelope.msg) == (name, 5, True, "ü")
            assert raw(codec.body(envelope, cls)) == raw(message), (name, seed)


def test_protobufs_own_reader_accepts_our_json() -> None:
    for name in TABLE:
        message = filled(random.Random(name), TYPES[name])
        for codec in (JsonCodec(), JsonCodec(defaults=True)):
            text = codec.encode(name, message)
            other = json_format.ParseDict(json.loads(text)["body"], TYPES[name]())
            assert raw(other) == raw(message), name


@pytest.mark.parametrize("x", [LARGEST, -LARGEST])
def test_protobufs_own_reader_accepts_the_largest_float(x: float) -> None:
    body = json.loads(JsonCodec().encode("woosh.robot.PoseSpeed", PoseSpeed(pose={"x": x})))["body"]
    assert json_format.ParseDict(body, PoseSpeed()).pose.x == x


def test_no_json_name_is_ambiguous() -> None:
    for name, cls in TYPES.items():
        owner: dict[str, str] = {}
        for field in cls.DESCRIPTOR.fields:
            for alias in {field.name, field.json_name}:
                assert owner.setdefault(alias, field.name) == field.name, name


surrogates = st.text(st.characters(codec=None), max_size=5)
leaves = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.integers(-(2**70), 2**70)
    | st.floats()
    | surrogates
    | st.sampled_from(["1e3", "-7", "NaN", "kAuto", "0x1", "9" * 400, "1e999", "true"])
)
trees = st.recursive(
    leaves,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(surrogates, inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.data())
def test_any_value_in_any_field_gives_a_value_or_a_field_error(data: st.DataObject) -> None:
    cls = TYPES[data.draw(st.sampled_from(TABLE))]
    names = [field.json_name for field in cls.DESCRIPTOR.fields] or ["none"]
    values = trees | st.lists(trees, max_size=3)
    body = data.draw(st.dictionaries(st.sampled_from(names), values))
    try:
        from_json(body, cls())
    except FieldError as error:
        str(error).encode()


def test_deep_nesting_gives_a_value_or_a_frame_error() -> None:
    """Also around the recursion limit of the interpreter."""
    for depth in (50, *range(700, 1000, 3), 5000, 200_000):
        for key in ("mapId", "twist"):
            deep = '{"a":' * depth + "1" + "}" * depth
            frame = f'{{"type":"woosh.robot.PoseSpeed","sn":1,"body":{{"{key}":{deep}}}}}'
            try:
                JsonCodec().body(JsonCodec().decode(frame), PoseSpeed)
            except FrameError as error:
                str(error).encode()  # an error text that can be logged


def test_the_text_of_an_error_is_short_and_quick_to_make_for_a_map() -> None:
    class Value:
        written = 0

        def __repr__(self) -> str:
            Value.written += 1
            return "x" * 10_000

    with pytest.raises(FieldError) as caught:
        from_json({"mapId": [Value()] * 1000}, PoseSpeed())
    assert len(str(caught.value)) < 200
    assert Value.written < 20


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("woosh.robot.PoseSpeed", {"pose": {"y": "x" * 100_000}}),
        ("woosh.robot.ScannerData", {"ranges": ["x" * 100_000]}),
        ("woosh.robot.PoseSpeed", {"mapId": "x" * 100_000}),
    ],
)
def test_the_text_of_an_error_does_not_repeat_a_long_value(name: str, body: Any) -> None:
    with pytest.raises(FieldError) as caught:
        from_json(body, TYPES[name]())
    assert len(str(caught.value)) < 300
