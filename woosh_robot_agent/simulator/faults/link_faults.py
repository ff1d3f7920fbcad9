"""Faults of the link: of connections, of requests and answers, and of frames."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import string
from collections.abc import Callable, Iterable
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.frames import Codec, FrameError
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.link.server import Encoded, ServerTransport, Write
from woosh_robot_agent.link.transport import varint
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson
from woosh_robot_agent.simulator.faults.fault import Argument, Begin, End, Fault, Injection
from woosh_robot_agent.simulator.serving.exchange import Outgoing, Release
from woosh_robot_agent.simulator.serving.server import Server

_MAX_SN = 2**31 - 1

TYPE = Argument(
    "type", str, "", "affects only answers to requests of this type; empty: all", is_message=True
)
COUNT = Argument("count", int, 0, "number of times that the fault takes effect; 0: no limit", low=0)
FRAMES = Argument(
    "frames",
    str,
    "answers",
    "frames that the fault affects; for pushes, `type` is the type of the push",
    choices=("answers", "pushes", "all"),
)


def applies_to(injection: Injection, frame: Outgoing) -> bool:
    """Return True if a fault affects a frame, by its arguments `type` and `frames`."""
    frames = injection.arguments.get("frames", "answers")
    name = frame.request if frame.is_answer else frame.type
    return (
        injection.active
        and frames in ("all", "answers" if frame.is_answer else "pushes")
        and injection["type"] in ("", name)
    )


def on_frames(
    alter: Callable[[Injection, Outgoing], Iterable[Outgoing]],
) -> Callable[[Server, Injection], End]:
    """Return the `begin` function of a fault that replaces the frames that it affects."""

    def begin(server: Server, injection: Injection) -> End:
        def intercept(frame: Outgoing) -> Iterable[Outgoing]:
            if not applies_to(injection, frame):
                return [frame]
            frames = alter(injection, frame)
            injection.hit()
            return frames

        return server.hooks.add_fault(intercept)

    return begin


def _refuse(server: Server, injection: Injection) -> End:
    def refusal(type_name: str) -> str | None:
        if injection["type"] not in ("", type_name):
            return None
        injection.hit()
        text: str = injection["text"]
        return text

    return server.hooks.add_refusal(refusal)


def _delay(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
    seconds = injection["seconds"] + injection.rng.uniform(0.0, injection["jitter"])
    return [dataclasses.replace(frame, delay=frame.delay + seconds)]


def _wrong_sn(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
    return [dataclasses.replace(frame, sn=(frame.sn + injection["by"] - 1) % _MAX_SN + 1)]


def _wrong_type(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
    return [dataclasses.replace(frame, type=injection["other"])]


class _Shuffle:
    """Collects the frames of each client up to a number or a timeout, and shuffles them."""

    def __init__(self, injection: Injection) -> None:
        self._injection = injection
        self._kept: dict[object, list[Release]] = {}
        self._timers: dict[object, asyncio.TimerHandle] = {}

    def keep(self, client: object, release: Release) -> None:
        kept = self._kept.setdefault(client, [])
        kept.append(release)
        if len(kept) >= self._injection["window"] or not self._injection.active:
            self._flush(client)
        elif client not in self._timers:
            loop = asyncio.get_running_loop()
            timer = loop.call_later(self._injection["seconds"], self._flush, client)
            self._timers[client] = timer

    def flush(self) -> None:
        for client in list(self._kept):
            self._flush(client)

    def _flush(self, client: object) -> None:
        timer = self._timers.pop(client, None)
        if timer:
            timer.cancel()
        kept = self._kept.pop(client)
        mixed = kept[:]
        self._injection.rng.shuffle(mixed)
        if mixed == kept:  # the shuffle had no effect
            mixed.reverse()
        for release in mixed:
            release()


def _reorder(server: Server, injection: Injection) -> End:
    shuffle = _Shuffle(injection)
    keep = on_frames(lambda injection, frame: [dataclasses.replace(frame, hold=shuffle.keep)])
    stop = keep(server, injection)

    def end() -> None:
        stop()
        shuffle.flush()

    return end


ANSWER_FAULTS = (
    Fault(
        "refuse",
        "requests are not executed, and answered with `ok` false and a text",
        _refuse,
        (
            Argument("text", str, "refused by the simulator", "text of the answers"),
            dataclasses.replace(TYPE, description="affects only requests of this type; empty: all"),
            COUNT,
        ),
    ),
    Fault(
        "delay",
        "answers are delayed; later ones may overtake them",
        on_frames(_delay),
        (
            Argument(
                "seconds", float, 1.0, "minimum delay", unit="s of real time", low=0.0, high=86400.0
            ),
            Argument(
                "jitter",
                float,
                0.0,
                "maximum of a random additional delay",
                unit="s of real time",
                low=0.0,
                high=86400.0,
            ),
            TYPE,
            COUNT,
            FRAMES,
        ),
    ),
    Fault(
        "reorder",
        "answers are collected and sent in another order",
        _reorder,
        (
            Argument("window", int, 4, "number of answers to collect", low=2, high=1000),
            Argument(
                "seconds",
                float,
                0.2,
                "maximum time to hold an answer back",
                unit="s of real time",
                low=0.0,
                high=3600.0,
            ),
            TYPE,
            COUNT,
        ),
    ),
    Fault(
        "lose_answer",
        "requests are executed, but their answers are not sent",
        on_frames(lambda injection, frame: []),
        (TYPE, COUNT),
    ),
    Fault(
        "answer_twice",
        "each answer is sent twice",
        on_frames(lambda injection, frame: [frame, frame]),
        (TYPE, COUNT),
    ),
    Fault(
        "wrong_sn",
        "the `sn` of an answer differs from that of its request",
        on_frames(_wrong_sn),
        (
            Argument(
                "by",
                int,
                1_000_000,
                "difference between the two serial numbers",
                low=1,
                high=_MAX_SN - 1,
            ),
            TYPE,
            COUNT,
        ),
    ),
    Fault(
        "wrong_type",
        "the `type` of an answer differs from that of its body",
        on_frames(_wrong_type),
        (
            Argument("other", str, "woosh.robot.Network", "wrong type of the answers"),
            TYPE,
            COUNT,
        ),
    ),
)


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

FRAME_FAULTS = (
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


def _drop(server: Server, injection: Injection) -> None:
    server.drop()


def _accept_then_drop(server: Server, injection: Injection) -> End:
    def refuse_connection() -> bool:
        injection.hit()
        return False

    return server.hooks.add_admission(refuse_connection)


def _off(server: Server, injection: Injection) -> End:
    server.set_listening(False)
    return lambda: server.set_listening(True)


def _half_open(server: Server, injection: Injection) -> End:
    server.pause_connections(True)
    return lambda: server.pause_connections(False)


def _freeze(server: Server, injection: Injection) -> End:
    server.freeze(True)
    return lambda: server.freeze(False)


LINK_FAULTS = (
    Fault("drop", "every connection ends, as with a broken cable", _drop, lasting=False),
    Fault(
        "accept_then_drop",
        "each new connection is accepted and closed at once, a WebSocket after its handshake",
        _accept_then_drop,
        (Argument("count", int, 0, "number of connections; 0: all", low=0),),
    ),
    Fault(
        "off",
        "every connection ends and new ones are refused, as if the robot were switched off; at "
        "the end it listens on the same ports again",
        _off,
        shared=True,
    ),
    Fault(
        "half_open",
        "nothing is read or written, but the sockets stay open, and new connections are accepted; "
        "at the end everything pending is read and written",
        _half_open,
        shared=True,
    ),
    Fault(
        "freeze",
        "the program of the robot hangs: simulated time stands still, requests are read but not "
        "executed, WebSocket pings are answered; at the end all pending requests are executed",
        _freeze,
        shared=True,
    ),
)
