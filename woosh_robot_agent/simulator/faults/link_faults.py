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

from woosh_robot_agent.link.config import MIB
from woosh_robot_agent.link.frames import Codec, FrameError
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.link.server import Encoded, ServerTransport, Write
from woosh_robot_agent.link.transport import CHUNK, varint
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson
from woosh_robot_agent.simulator.faults.fault import Argument, Begin, End, Injection, fault
from woosh_robot_agent.simulator.serving.exchange import Outgoing, Release, add_hook
from woosh_robot_agent.simulator.serving.server import Server


@fault("every connection ends, as with a broken cable", lasting=False)
def _drop(server: Server, injection: Injection) -> None:
    server.drop()


@fault(
    "each new connection is accepted and closed at once, a WebSocket after its handshake",
    Argument("count", 0, "number of connections; 0: all", 0),
)
def _accept_then_drop(server: Server, injection: Injection) -> End:
    def refuse_connection() -> bool:
        injection.hit()
        return False

    return add_hook(server.hooks.admissions, refuse_connection)


@fault(
    "every connection ends and new ones are refused, as if the network were switched off: the "
    "robot goes on with what it does; at the end it listens on the same ports again",
    shared=True,
)
def _off(server: Server, injection: Injection) -> End:
    server.set_listening(False)
    return lambda: server.set_listening(True)


@fault(
    "nothing is read or written, but the sockets stay open, and new connections are accepted; "
    "at the end everything pending is read and written",
    shared=True,
)
def _half_open(server: Server, injection: Injection) -> End:
    server.pause_connections(True)
    return lambda: server.pause_connections(False)


@fault(
    "the program of the robot hangs: simulated time stands still, requests are read but not "
    "executed, WebSocket pings are answered; at the end all pending requests are executed",
    shared=True,
)
def _freeze(server: Server, injection: Injection) -> End:
    server.freeze(True)
    return lambda: server.freeze(False)


_MAX_SN = 2**31 - 1
"""Largest serial number of a request."""

_TYPE = Argument(
    "type", "", "affects only answers to requests of this type; empty: all", is_message=True
)
_COUNT = Argument("count", 0, "number of times that the fault takes effect; 0: no limit", 0)
_FRAMES = Argument(
    "frames",
    "answers",
    "frames that the fault affects; for pushes, `type` is the type of the push",
    choices=("answers", "pushes", "all"),
)


def _on_frames(
    alter: Callable[[Injection, Outgoing], Iterable[Outgoing]],
) -> Callable[[Server, Injection], End]:
    """Return a `Begin` function for a fault that changes outgoing frames.

    Args:
        alter: returns the frames to send instead of a frame that the fault affects.
    """

    def begin(server: Server, injection: Injection) -> End:
        def intercept(frame: Outgoing) -> Iterable[Outgoing]:
            kind, name = ("answers", frame.request) if frame.is_answer else ("pushes", frame.type)
            # Faults without the argument `frames` affect only answers.
            of_kind = injection.arguments.get("frames", "answers") in (kind, "all")
            of_type = injection["type"] in (name, "")
            # `answer_twice` makes two frames: the first may have ended this fault by its `count`.
            if injection.active and of_kind and of_type:
                altered = alter(injection, frame)
                injection.hit()
                return altered
            return [frame]

        return add_hook(server.hooks.faults, intercept)

    begin.__name__ = alter.__name__  # `fault` takes the name of the fault from it
    return begin


@fault(
    "requests are not executed, and answered with `ok` false and a text",
    Argument("text", "refused by the simulator", "text of the answers"),
    dataclasses.replace(_TYPE, description="affects only requests of this type; empty: all"),
    _COUNT,
)
def _refuse(server: Server, injection: Injection) -> End:
    def refusal(type_name: str) -> str | None:
        if injection["type"] not in ("", type_name):
            return None
        injection.hit()
        text: str = injection["text"]
        return text

    return add_hook(server.hooks.refusals, refusal)


@fault(
    "answers are delayed; later ones may overtake them",
    Argument("seconds", 1.0, "minimum delay", 0, 86400, unit="s of real time"),
    Argument(
        "jitter", 0.0, "maximum of a random additional delay", 0, 86400, unit="s of real time"
    ),
    _TYPE,
    _COUNT,
    _FRAMES,
)
@_on_frames
def _delay(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
    seconds = injection["seconds"] + injection.rng.uniform(0.0, injection["jitter"])
    return [dataclasses.replace(frame, delay=frame.delay + seconds)]


class _Shuffle:
    """Collects up to `window` frames to each client, or for `seconds`, and sends them shuffled."""

    def __init__(self, injection: Injection) -> None:
        self._injection = injection
        self._kept: dict[object, list[Release]] = {}
        """Functions that send the collected frames, by client."""
        self._timers: dict[object, asyncio.TimerHandle] = {}
        """Timeouts of the collected frames, by client."""

    def keep(self, client: object, release: Release) -> None:
        """Collect a frame to `client`, which `release` sends."""
        kept = self._kept.setdefault(client, [])
        kept.append(release)
        # The frame that reaches `count` ends the fault, and only then comes here: send it at once.
        if len(kept) >= self._injection["window"] or not self._injection.active:
            self._flush_client(client)
        elif client not in self._timers:
            loop = asyncio.get_running_loop()
            timer = loop.call_later(self._injection["seconds"], self._flush_client, client)
            self._timers[client] = timer

    def flush(self) -> None:
        """Send all collected frames."""
        for client in list(self._kept):
            self._flush_client(client)

    def _flush_client(self, client: object) -> None:
        """Send the collected frames to a client, in another order."""
        timer = self._timers.pop(client, None)
        if timer:
            timer.cancel()
        kept = self._kept.pop(client)
        shuffled = kept[:]
        self._injection.rng.shuffle(shuffled)
        if shuffled == kept:  # the order must change
            shuffled.reverse()
        for release in shuffled:
            release()


@fault(
    "answers are collected and sent in another order",
    Argument("window", 4, "number of answers to collect", 2, 1000),
    Argument("seconds", 0.2, "maximum time to hold an answer back", 0, 3600, unit="s of real time"),
    _TYPE,
    _COUNT,
)
def _reorder(server: Server, injection: Injection) -> End:
    shuffle = _Shuffle(injection)
    begin = _on_frames(lambda injection, frame: [dataclasses.replace(frame, hold=shuffle.keep)])
    stop = begin(server, injection)

    def end() -> None:
        stop()
        shuffle.flush()

    return end


@fault("requests are executed, but their answers are not sent", _TYPE, _COUNT)
@_on_frames
def _lose_answer(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
    return []


@fault("each answer is sent twice", _TYPE, _COUNT)
@_on_frames
def _answer_twice(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
    return [frame, frame]


@fault(
    "the `sn` of an answer differs from that of its request",
    Argument("by", 1_000_000, "difference between the two serial numbers", 1, _MAX_SN - 1),
    _TYPE,
    _COUNT,
)
@_on_frames
def _wrong_sn(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
    # After the largest serial number comes 1.
    return [dataclasses.replace(frame, sn=(frame.sn + injection["by"] - 1) % _MAX_SN + 1)]


@fault(
    "the `type` of an answer differs from that of its body",
    Argument("other", "woosh.robot.Network", "wrong type of the answers"),
    _TYPE,
    _COUNT,
)
@_on_frames
def _wrong_type(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
    return [dataclasses.replace(frame, type=injection["other"])]


_UNKNOWN_NAME, _UNKNOWN_VALUE = "fieldOfLaterFirmware", {"level": [1, 2.5, "x", None]}
_UNKNOWN_NUMBER = 1999
"""Name, value and number of a field that no message of the chassis has."""

_VARINT, _FIXED64, _DELIMITED = 0, 1, 2
"""Wire types of protobuf."""

_FIXED64_TYPES = (
    FieldDescriptor.TYPE_DOUBLE,
    FieldDescriptor.TYPE_FIXED64,
    FieldDescriptor.TYPE_SFIXED64,
)
"""Types of fields with the wire type `_FIXED64`."""

Json = dict[str, Any]

_SELECTION = (_TYPE, _COUNT, _FRAMES)
"""Arguments that select the frames to damage."""


def _damaging(damage: Callable[[Injection, Codec, str | bytes], Encoded]) -> Begin:
    """Return a `Begin` function for a fault that damages encoded frames.

    Args:
        damage: returns the damaged form of an encoded frame.
    """

    def alter(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
        damage_before = frame.damage  # that of another fault

        def damage_further(codec: Codec, data: str | bytes) -> Encoded:
            damaged = damage_before(codec, data) if damage_before else data
            # Frames that the other fault writes itself or makes unreadable are left at that.
            if callable(damaged) or (damage_before and not _readable(codec, damaged)):
                return damaged
            return damage(injection, codec, damaged)

        return [dataclasses.replace(frame, damage=damage_further)]

    alter.__name__ = damage.__name__
    return _on_frames(alter)


@fault(
    "frames are replaced by noise: text instead of JSON, bytes instead of protobuf",
    Argument("length", 64, "length of the noise", 1, MIB, unit="bytes"),
    *_SELECTION,
)
@_damaging
def _garbage(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    length = injection["length"]
    if isinstance(data, str):
        # No JSON text begins with a question mark.
        return "?" + "".join(injection.rng.choices(string.printable, k=length - 1))
    # No valid protobuf message begins with ten 0xFF bytes: a varint has at most ten bytes.
    return (b"\xff" * 10 + injection.rng.randbytes(length))[:length]


@fault(
    "frames are cut in the middle",
    Argument(
        "where",
        "payload",
        "payload: a valid frame with half the data; wire: half the frame, then the connection is "
        "aborted",
        choices=("payload", "wire"),
    ),
    *_SELECTION,
)
@_damaging
def _truncated(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    if injection["where"] == "wire":
        return _truncated_on_wire(data)
    cut = len(data) // 2
    while _readable(codec, data[:cut]):  # by chance, half a protobuf message may be valid
        cut += 1
    return data[:cut]


def _truncated_on_wire(data: str | bytes) -> Write:
    """Return a function that writes half a frame, and aborts the connection."""
    raw = _bytes(data)

    async def write(transport: ServerTransport) -> None:
        header = transport.header(len(raw), text=isinstance(data, str))
        await transport.send_raw(header + raw[: len(raw) // 2])
        transport.abort()

    return write


@fault(
    "frames are padded to a size that clients refuse, with blanks or an unknown field",
    Argument("mib", 65, "size of the frames", 1, 4096, unit="MiB"),
    *_SELECTION,
)
@_damaging
def _oversize(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    """Pad a valid frame: JSON with blanks, protobuf with an unknown field of zeros."""
    raw = _bytes(data)
    text = isinstance(data, str)
    padding = max(0, injection["mib"] * MIB - len(raw))
    if not text:
        raw += _tag(_UNKNOWN_NUMBER, _DELIMITED) + varint(padding)
    filling = (b" " if text else b"\0") * CHUNK

    async def write(transport: ServerTransport) -> None:
        await transport.send_raw(transport.header(len(raw) + padding, text=text) + raw)
        left = padding
        while left:
            part = filling[:left]
            await transport.send_raw(part)
            left -= len(part)

    return write


@fault("the type name in frames is invalid UTF-8", *_SELECTION)
@_damaging
def _invalid_utf8(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    raw = bytearray(_bytes(data))
    type_name = raw.find(b"woosh")
    raw[type_name if type_name >= 0 else len(raw) // 2] = 0xFF
    if not isinstance(data, str):
        return bytes(raw)

    async def write(transport: ServerTransport) -> None:
        # The server's library sends only valid UTF-8 as text.
        await transport.send_raw(transport.header(len(raw), text=True) + raw)

    return write


@fault("frames and their bodies have additional fields that clients do not know", *_SELECTION)
@_damaging
def _unknown_fields(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    if isinstance(data, str):
        frame: Json = json.loads(data)
        if isinstance(frame["body"], dict):  # "wrong_field_type" may have replaced it
            frame["body"][_UNKNOWN_NAME] = _UNKNOWN_VALUE
        return _json({_UNKNOWN_NAME: _UNKNOWN_VALUE, **frame})
    unknown = _tag(_UNKNOWN_NUMBER, _DELIMITED) + varint(3) + b"new"
    pack = MessagePackJson.FromString(data)
    pack.body.value += unknown
    return unknown + pack.SerializeToString()


@fault(
    "a random field of the body has a value of another type; protobuf readers treat it as an "
    "unknown field",
    *_SELECTION,
)
@_damaging
def _wrong_field_type(injection: Injection, codec: Codec, data: str | bytes) -> Encoded:
    if isinstance(data, str):
        frame: Json = json.loads(data)
        body = frame["body"]
        if body and isinstance(body, dict):  # not yet replaced by this fault
            name = injection.rng.choice(list(body))
            # A text in place of a list or an object; an object in place of anything else.
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
    # A wire type that the field cannot have.
    wire_type, value = (_VARINT, b"\1") if field.type in _FIXED64_TYPES else (_FIXED64, b"\1" * 8)
    pack.body.value = message.SerializeToString() + _tag(field.number, wire_type) + value
    return pack.SerializeToString()


def _body(pack: MessagePackJson) -> Message | None:
    """Return the decoded body of a frame, None if its type is unknown."""
    try:
        # not `pack.type`, which the fault `wrong_type` changes
        return message_type(pack.body.TypeName()).FromString(pack.body.value)
    except KeyError:
        return None


def _readable(codec: Codec, data: str | bytes) -> bool:
    """Return True if `data` is a valid frame."""
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
    """Return the protobuf tag of a field: its number and its wire type."""
    return varint(number << 3 | wire_type)
