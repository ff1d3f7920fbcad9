"""Protobuf encoding: a serialized woosh.commu_pack.MessagePackJson, for gateways and for speed."""

from __future__ import annotations

from google.protobuf.message import DecodeError, Message

from woosh_robot_agent.link.frames import Envelope, FrameError, M, clip_type_name
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson

_TYPE_URL_PREFIX = "type.googleapis.com/"
_UNREADABLE = (DecodeError, ValueError, RecursionError)
"""Errors of the parser. The parser in pure Python has no depth limit, and raises RecursionError."""
_TEXT_FRAME = "a text frame on a protobuf link; check `encoding`"


class ProtobufCodec:
    """Frames as protobuf bytes, which have no timestamp."""

    def encode(
        self,
        type_name: str,
        body: Message | None,
        *,
        sn: int = 0,
        ok: bool | None = None,
        msg: str = "",
        timestamp: int | None = None,
    ) -> bytes:
        pack = MessagePackJson(type=type_name, sn=sn, ok=bool(ok), msg=msg)
        if body is not None:
            pack.body.type_url = _TYPE_URL_PREFIX + body.DESCRIPTOR.full_name
            pack.body.value = body.SerializeToString()
        return pack.SerializeToString()

    def decode(self, data: str | bytes) -> Envelope:
        if isinstance(data, str):
            raise FrameError("encoding", _TEXT_FRAME)
        pack = MessagePackJson()
        try:
            pack.ParseFromString(data)
        except _UNREADABLE as error:
            if data[:1] == b"{":  # no MessagePackJson begins with a brace, but JSON does
                raise FrameError("encoding", _TEXT_FRAME) from None
            raise FrameError("protobuf", f"not a MessagePackJson: {error}") from None
        if not pack.type and not pack.sn:  # an answer needs only its sn
            raise FrameError("envelope", "no type")
        return Envelope(
            type=clip_type_name(pack.type),
            body=pack.body.value,
            ok=pack.ok if pack.sn else None,
            msg=pack.msg,
            sn=pack.sn,
        )

    def body(self, envelope: Envelope, cls: type[M]) -> M:
        message = cls()
        try:
            message.ParseFromString(envelope.body)  # type: ignore[arg-type]  # decode() left bytes
        except _UNREADABLE as error:
            raise FrameError("body", f"{envelope.type}: {error}") from None
        return message
