"""Both codecs with random messages and data: round trips are exact; bad data gives FrameError."""

from __future__ import annotations

import json
import random
import re
from typing import Any

import pytest
from google.protobuf import json_format

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
    largest = [PoseSpeed(pose={"x": x}) for x in (LARGEST, -LARGEST)]
    for message in (*(filled(random.Random(name), TYPES[name]) for name in TABLE), *largest):
        for codec in (JsonCodec(), JsonCodec(defaults=True)):
            text = codec.encode(message.DESCRIPTOR.full_name, message)
            other = json_format.ParseDict(json.loads(text)["body"], type(message)())
            assert raw(other) == raw(message), message.DESCRIPTOR.full_name


def test_no_json_name_is_ambiguous() -> None:
    for name, cls in TYPES.items():
        owner: dict[str, str] = {}
        for field in cls.DESCRIPTOR.fields:
            for alias in {field.name, field.json_name}:
                assert owner.setdefault(alias, field.name) == field.name, name


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


class SlowToWrite:
    """A value whose text is long and costs time."""

    written = 0

    def __repr__(self) -> str:
        SlowToWrite.written += 1
        return "x" * 10_000


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("woosh.robot.PoseSpeed", {"pose": {"y": "x" * 100_000}}),
        ("woosh.robot.ScannerData", {"ranges": ["x" * 100_000]}),
        ("woosh.robot.PoseSpeed", {"mapId": "x" * 100_000}),
        ("woosh.robot.PoseSpeed", {"mapId": [SlowToWrite()] * 1000}),
    ],
    ids=["number in a message", "number in a list", "number", "list"],
)
def test_the_text_of_an_error_is_short_and_quick_to_make(name: str, body: Any) -> None:
    with pytest.raises(FieldError) as caught:
        from_json(body, TYPES[name]())
    assert len(str(caught.value)) < 300
    assert SlowToWrite.written < 20
