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
from tests.link.link_peer import packed
from woosh_robot_agent.link.codecs.json_codec import JsonCodec, from_json
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.frames import FieldError, FrameError
from woosh_robot_agent.link.protos import message_types
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SwitchControlMode
from woosh_robot_agent.pb.robot.robot_pb2 import Mode, PoseSpeed
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription

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


# Binary frames as they are on the wire, byte by byte

CODEC = ProtobufCodec()


def test_a_request_as_on_the_wire() -> None:
    request = SwitchControlMode(mode=1)  # type: ignore[arg-type]
    assert CODEC.encode("woosh.robot.SwitchControlMode", request, sn=300) == (
        b"\x0a\x1dwoosh.robot.SwitchControlMode"
        b"\x12\x37\x0a\x31type.googleapis.com/woosh.robot.SwitchControlMode\x12\x02\x08\x01"
        b"\xc8\x0c\xac\x02"
    )


def test_a_subscription_as_on_the_wire() -> None:
    body = Subscription(topics=["woosh.robot.Mode"], sub=True)
    assert CODEC.encode("woosh.Subscription", body) == (
        b"\x0a\x12woosh.Subscription"
        b"\x12\x49\x0a\x31type.googleapis.com/woosh.commu_pack.Subscription"
        b"\x12\x14\x08\x01\x5a\x10woosh.robot.Mode"
    )


def test_an_answer_as_on_the_wire() -> None:
    envelope = CODEC.decode(
        b"\x0a\x10woosh.robot.Mode"
        b"\x12\x2c\x0a\x24type.googleapis.com/woosh.robot.Mode\x12\x04\x08\x01\x10\x02"
        b"\xa8\x06\x01\xb2\x06\x02Ja\xc8\x0c\x08"
    )
    assert (envelope.type, envelope.ok) == ("woosh.robot.Mode", True)
    assert (envelope.msg, envelope.sn, envelope.timestamp) == ("Ja", 8, None)
    assert CODEC.body(envelope, Mode) == Mode(ctrl=1, work=2)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"\xff\xff", "protobuf"),
        (b"\x0a\x02\xff\xff", "protobuf"),  # the type is not UTF-8
        (b"", "envelope"),
        (packed({"msg": "no type"}), "envelope"),
        ("{}", "encoding"),
        (b'{"type":"woosh.robot.Mode"}', "encoding"),
    ],
)
def test_data_that_is_not_a_frame_gives_an_error_of_its_kind(data: str | bytes, kind: str) -> None:
    with pytest.raises(FrameError) as caught:
        CODEC.decode(data)
    assert caught.value.kind == kind
