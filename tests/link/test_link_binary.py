"""Binary frames as they are on the wire, byte by byte."""

from __future__ import annotations

import pytest

from tests.link.link_peer import packed
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.frames import FrameError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SwitchControlMode
from woosh_robot_agent.pb.robot.robot_pb2 import Mode
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription

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
