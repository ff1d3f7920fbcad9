"""Binary frames as they are on the wire, encoded without the protobuf library."""

from __future__ import annotations

import pytest

from tests.link.link_peer import Packed
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.frames import FrameError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SwitchControlMode
from woosh_robot_agent.pb.robot.robot_pb2 import Mode
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription

CODEC = ProtobufCodec()


def test_a_request_as_on_the_wire() -> None:
    request = SwitchControlMode(mode=1)  # type: ignore[arg-type]
    frame = Packed.unpack(CODEC.encode("woosh.robot.SwitchControlMode", request, sn=300))
    assert frame == {
        "type": "woosh.robot.SwitchControlMode",
        "url": "type.googleapis.com/woosh.robot.SwitchControlMode",
        "body": b"\x08\x01",
        "sn": 300,
    }


def test_a_subscription_as_on_the_wire() -> None:
    body = Subscription(topics=["woosh.robot.Mode"], sub=True)
    frame = Packed.unpack(CODEC.encode("woosh.Subscription", body))
    assert frame == {
        "type": "woosh.Subscription",
        "url": "type.googleapis.com/woosh.commu_pack.Subscription",
        "body": b"\x08\x01" + Packed.chunk(11, b"woosh.robot.Mode"),
    }


def test_an_answer_as_on_the_wire() -> None:
    data = Packed.pack(
        {"type": "woosh.robot.Mode", "body": b"\x08\x01\x10\x02", "ok": 1, "msg": "Ja", "sn": 8}
    )
    envelope = CODEC.decode(data)
    assert (envelope.type, envelope.ok) == ("woosh.robot.Mode", True)
    assert (envelope.msg, envelope.sn, envelope.timestamp) == ("Ja", 8, None)
    assert CODEC.body(envelope, Mode) == Mode(ctrl=1, work=2)  # type: ignore[arg-type]


def test_a_push_has_neither_sn_nor_ok() -> None:
    envelope = CODEC.decode(Packed.pack({"type": "woosh.robot.Mode", "body": b""}))
    assert (envelope.sn, envelope.ok) == (0, None)


def test_a_refusal_needs_no_body() -> None:
    envelope = CODEC.decode(Packed.pack({"type": "error", "msg": "no", "sn": 9}))
    assert (envelope.ok, envelope.msg, envelope.sn) == (False, "no", 9)


def test_an_answer_without_a_type_is_still_an_answer() -> None:
    assert CODEC.decode(Packed.pack({"sn": 9, "ok": 1})).sn == 9


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"\xff\xff", "protobuf"),
        (b"\x0a\x02\xff\xff", "protobuf"),  # the type is not UTF-8
        (b"", "envelope"),
        (Packed.pack({"msg": "no type"}), "envelope"),
        ("{}", "encoding"),
        (b'{"type":"woosh.robot.Mode"}', "encoding"),
    ],
)
def test_data_that_is_not_a_frame_gives_an_error_of_its_kind(data: str | bytes, kind: str) -> None:
    with pytest.raises(FrameError) as caught:
        CODEC.decode(data)
    assert caught.value.kind == kind


def test_a_body_that_cannot_be_read_is_a_frame_error() -> None:
    envelope = CODEC.decode(Packed.pack({"type": "woosh.robot.Mode", "body": b"\xff", "sn": 1}))
    with pytest.raises(FrameError) as caught:
        CODEC.body(envelope, Mode)
    assert caught.value.kind == "body"
