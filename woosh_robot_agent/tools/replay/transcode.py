"""Conversion of recorded frames to the encoding of the receiving client."""

from __future__ import annotations

import json

from woosh_robot_agent.link.codecs.choice import server_codec
from woosh_robot_agent.link.codecs.frames import Codec, FrameError
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson
from woosh_robot_agent.protos import message_types


def transcode(frame: str | bytes, codec: Codec, sn: int | None = None) -> str | bytes:
    """Return a recorded frame in another encoding, and with another serial number.

    A frame that needs no change, or cannot be read, is returned as it is.

    Args:
        frame: The recorded frame.
        codec: Encoding of the receiver.
        sn: Serial number of the receiver's request; None for a push.
    """
    recorded = server_codec(frame)
    if recorded is not codec:
        return _reencode(frame, recorded, codec, sn)
    if sn is None:
        return frame
    if isinstance(frame, str):
        return json.dumps({**json.loads(frame), "sn": sn}, ensure_ascii=False)
    pack = MessagePackJson.FromString(frame)
    pack.sn = sn
    return pack.SerializeToString()


def _reencode(frame: str | bytes, recorded: Codec, codec: Codec, sn: int | None) -> str | bytes:
    try:
        envelope = recorded.decode(frame)
        cls = message_types().get(envelope.type)
        body = None if cls is None else recorded.body(envelope, cls)
    except FrameError:
        return frame
    return codec.encode(
        envelope.type,
        body,
        sn=sn or 0,
        ok=envelope.ok,
        msg=envelope.msg,
        timestamp=envelope.timestamp,
    )
