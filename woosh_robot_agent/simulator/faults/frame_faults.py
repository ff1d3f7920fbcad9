"""Faults that damage single frames after they are encoded."""

from __future__ import annotations

import dataclasses
import json
import string
from collections.abc import Callable, Iterable
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.frames import Codec, FrameError
from woosh_robot_agent.link.server.base import ServerTransport
from woosh_robot_agent.link.server.outbox import Encoded, Write
from woosh_robot_agent.link.transport.tcp import varint
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson
from woosh_robot_agent.protos import message_type
from woosh_robot_agent.simulator.faults.answer_faults import COUNT, FRAMES, TYPE, on_frames
from woosh_robot_agent.simulator.faults.arguments import Argument
from woosh_robot_agent.simulator.faults.fault import Begin, Fault, Injection
from woosh_robot_agent.simulator.serving.hooks import Outgoing

_MIB = 1024 * 1024
_CHUNK = 256 * 1024
_UNKNOWN_NAME, _UNKNOWN_VALUE = "fieldOfLaterFirmware", {"level": [1, 2.5, "x", None]}
_UNKNOWN_NUMBER = 1999
"""A field that no message of the chassis has: name, value and number."""
_VARINT, _FIXED64, _DELIMITED = 0, 1, 2
_WIDE = (
    FieldDescriptor.TYPE_DOUBLE,
    FieldDescriptor.TYPE_FIXED64,
    FieldDescriptor.TYPE_SFIXED64,
)

Json = dict[str, Any]


def _damaging(damage: Callable[[Injection, Codec, str | bytes], Encoded]) -> Begin:
    def alter(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
        before = frame.damage

        def damage_further(codec: Codec, data: str | bytes) -> Encoded:
            damaged = before(codec, data) if before else data
            # A frame that is already unreadable, or written by a fault, is not damaged further.
            if callable(damaged) or (before and not _readable(codec, damaged)):
                return damaged
            return damage(injection, codec, damaged)

        return [dataclasses.replace(frame, damage=damage_further)]

    return on_frames(alter)


def _garbage(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    length = injection["length"]
    if isinstance(data, str):
        # No JSON text begins with a question mark.
        return "?" + "".join(injection.rng.choices(string.printable, k=length - 1))
    # No valid protobuf message begins with ten 0xFF bytes: a varint has at most ten bytes.
    return (b"\xff" * 10 + injection.rng.randbytes(length))[:length]


def _truncated(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    if injection["where"] == "wire":
        return _truncated_on_wire(data)
    cut = len(data) // 2
    while _readable(codec, data[:cut]):  # by chance, half a protobuf message may be valid
        cut += 1
    return data[:cut]


def _truncated_on_wire(data: str | bytes) -> Write:
    raw = _bytes(data)

    async def write(transport: ServerTransport) -> None:
        header = transport.header(len(raw), text=isinstance(data, str))
        await transport.send_raw(header + raw[: len(raw) // 2])
        transport.abort()

    return write


def _oversize(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    """Pad a valid frame: JSON with blanks, protobuf with an unknown field of zeros."""
    raw = _bytes(data)
    text = isinstance(data, str)
    padding = max(0, injection["mib"] * _MIB - len(raw))
    if not text:
        raw += _tag(_UNKNOWN_NUMBER, _DELIMITED) + varint(padding)
    filling = (b" " if text else b"\0") * _CHUNK

    async def write(transport: ServerTransport) -> None:
        await transport.send_raw(transport.header(len(raw) + padding, text=text) + raw)
        left = padding
        while left:
            part = filling[:left]
            await transport.send_raw(part)
            left -= len(part)

    return write


def _invalid_utf8(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    raw = bytearray(_bytes(data))
    raw[raw.find(b"woosh") if b"woosh" in raw else len(raw) // 2] = 0xFF
    if not isinstance(data, str):
        return bytes(raw)

    async def write(transport: ServerTransport) -> None:
        # websockets refuses to send invalid UTF-8 as text.
        await transport.send_raw(transport.header(len(raw), text=True) + raw)

    return write


def _unknown_fields(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    if isinstance(data, str):
        frame: Json = json.loads(data)
        frame["body"][_UNKNOWN_NAME] = _UNKNOWN_VALUE
        return _json({_UNKNOWN_NAME: _UNKNOWN_VALUE, **frame})
    unknown = _tag(_UNKNOWN_NUMBER, _DELIMITED) + varint(3) + b"new"
    pack = MessagePackJson.FromString(data)
    pack.body.value += unknown
    return unknown + pack.SerializeToString()


def _wrong_field_type(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    if isinstance(data, str):
        frame: Json = json.loads(data)
        body = frame["body"]
        if body:
            name = injection.rng.choice(list(body))
            body[name] = "neither" if isinstance(body[name], dict | list) else {"neither": 1}
        else:
            frame["body"] = "neither"
        return _json(frame)
    pack = MessagePackJson.FromString(data)
    message = _body(pack)
    if message is None or not message.DESCRIPTOR.fields:
        return data
    present: list[Any] = [field for field, _ in message.ListFields()]
    field = injection.rng.choice(present or list(message.DESCRIPTOR.fields))
    message.ClearField(field.name)
    wire_type, value = (_VARINT, b"\1") if field.type in _WIDE else (_FIXED64, b"\1" * 8)
    pack.body.value = message.SerializeToString() + _tag(field.number, wire_type) + value
    return pack.SerializeToString()


def _body(pack: MessagePackJson) -> Message | None:
    try:
        message = message_type(pack.type)()
        message.ParseFromString(pack.body.value)
    except KeyError:
        return None
    return message


def _readable(codec: Codec, data: str | bytes) -> bool:
    try:
        codec.decode(data)
    except FrameError:
        return False
    return True


def _bytes(data: str | bytes) -> bytes:
    return data.encode() if isinstance(data, str) else data


def _json(frame: Json) -> str:
    return json.dumps(frame, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def _tag(number: int, wire_type: int) -> bytes:
    return varint(number << 3 | wire_type)


_SELECTION = (TYPE, COUNT, FRAMES)

FAULTS = (
    Fault(
        "garbage",
        "frames are replaced by noise: text instead of JSON, bytes instead of protobuf",
        _damaging(_garbage),
        (
            Argument("length", int, 64, "length of the noise", unit="bytes", low=1, high=_MIB),
            *_SELECTION,
        ),
    ),
    Fault(
        "truncated",
        "frames are cut in the middle",
        _damaging(_truncated),
        (
            Argument(
                "where",
                str,
                "payload",
                "payload: a valid frame with half the data; wire: half the frame, then the "
                "connection is aborted",
                choices=("payload", "wire"),
            ),
            *_SELECTION,
        ),
    ),
    Fault(
        "oversize",
        "frames are padded to a size that clients refuse, with blanks or an unknown field",
        _damaging(_oversize),
        (
            Argument("mib", int, 65, "size of the frames", unit="MiB", low=1, high=4096),
            *_SELECTION,
        ),
    ),
    Fault(
        "invalid_utf8",
        "the type name in frames is invalid UTF-8",
        _damaging(_invalid_utf8),
        _SELECTION,
    ),
    Fault(
        "unknown_fields",
        "frames and their bodies have additional fields that clients do not know",
        _damaging(_unknown_fields),
        _SELECTION,
    ),
    Fault(
        "wrong_field_type",
        "a random field of the body has a value of another type; protobuf readers treat it as an "
        "unknown field",
        _damaging(_wrong_field_type),
        _SELECTION,
    ),
)
