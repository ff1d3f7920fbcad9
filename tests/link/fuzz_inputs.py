"""Inputs for fuzzing: real frames of every type, and mutations of them by a seeded generator."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from functools import cache
from typing import Any

from google.protobuf.any_pb2 import Any as AnyMessage
from google.protobuf.descriptor import FieldDescriptor as Kind
from google.protobuf.message import Message

from tests.link.test_link_json import FRAMES
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.protos import message_types
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson
from woosh_robot_agent.simulator.protocol.handlers import HANDLERS

DOCUMENTED = (
    *FRAMES,
    '{"type":"woosh.ros.CallAction","body":{"stepControl":{"action":1,"steps":[{"mode":1,'
    '"value":1,"speed":0.5}]},"moveBase":{"action":1}},"sn":3}',
    '{"type":"woosh.robot.RobotWiFi","body":{"order":"kAdd","content":"eyJzc2lkIjoiYSJ9"},"sn":4}',
)
"""Frames from the link's documentation, and one with a oneof and one with base64."""

_ANY = "google.protobuf.Any"
_FLOATS = (0.0, -0.0, 1.0, -1.0, 0.5, 4.23, 1e-300, 1e38, -1e38, 1e300, 5e-324)
_ODD_FLOATS = (float("nan"), float("inf"), float("-inf"))
_STRINGS = ("", "A2", "U5", "K10", "nowhere", "wooshmap", "\0", "é🤖", "x" * 3000, "../../etc")
_BYTES = (b"", b'{"ssid":"woosh-guest"}', b"\xff\xfe", b"{" * 50, b"\0" * 3000)
_RANGES = {
    Kind.CPPTYPE_INT32: (-(2**31), 2**31 - 1),
    Kind.CPPTYPE_UINT32: (0, 2**32 - 1),
    Kind.CPPTYPE_INT64: (-(2**63), 2**63 - 1),
    Kind.CPPTYPE_UINT64: (0, 2**64 - 1),
}
_MAX_DEPTH = 4
"""Depth down to which messages are filled."""
_DEEP = 100_000
"""Number of nested brackets in some inputs, far more than any parser supports."""

_NASTY: tuple[str, ...] = (
    *("null", "true", "false", "0", "-1", "1e3", "-0.0", "1e999", "-1e999", "1.5", "NaN"),
    *("Infinity", "-Infinity", '"NaN"', '"-Infinity"', '"1e3"', '"1e999"', '"0x1"', '" 7"'),
    *("2147483648", "-2147483649", "4294967296", "9223372036854775808", "18446744073709551616"),
    *('"9223372036854775808"', '"-1"', '"٣"', '"1_0"', '"true"', '"kAuto"', '"kNoSuchName"'),
    *('""', '"\\u0000"', '"\\ud800"', '"\\udc00\\ud800"', '"a\\ud800b"', '"\\ud83e\\udd16"'),
    *('"===="', '"YQ"', '"YQ="', '"Y Q=="', '"-_-_"', '"YQ==YQ=="', '"\\u00e9"', "[]", "{}"),
    *("[[]]", "[{}]", "[null]", "[null,null,1]", '{"":0}', '{"x":null}', '{"a":{"a":{"a":1}}}'),
    *('{"@type":"type.googleapis.com/woosh.robot.Mode"}', '{"@type":1}', '{"value":"x"}'),
    *("9" * 500, '"' + "9" * 5000 + '"', "-" + "9" * 5000, "1e-" + "9" * 30, "0." + "1" * 3000),
    *("[" + "0," * 2000 + "0]", '"' + "x" * 5000 + '"', '{"x":1,"x":"y","x":[]}'),
)
_TOKENS = ("{", "}", "[", "]", '"', ":", ",", "\\", "\\u", "\0", "\ufeff", "\ud800", "e", "-", "//")


def filled(rng: random.Random, cls: type[Message], depth: int = 0, odd: float = 0.02) -> Message:
    """Return a message with some fields set, half of them to limits of their ranges.

    Args:
        rng: source of randomness.
        cls: class of the message.
        depth: depth of the message in an outer one.
        odd: share of the floating-point numbers that are not finite.
    """
    message = cls()
    fields = list(cls.DESCRIPTOR.fields)
    share = rng.choice((0.3, 0.7, 1.0)) / (1 + depth / 2)
    for field in fields:
        if rng.random() > share:
            continue
        if field.message_type is not None and (
            depth >= _MAX_DEPTH or field.message_type.full_name not in (_ANY, *message_types())
        ):
            continue
        value = getattr(message, field.name)
        if hasattr(value, "extend"):
            count = rng.choice((1, 1, 2, 3, 8)) if rng.random() > 0.003 else 1000 >> (3 * depth)
            value.extend(_value(rng, field, depth, odd) for _ in range(count))
        elif field.message_type is not None:
            value.CopyFrom(_value(rng, field, depth, odd))
        else:
            setattr(message, field.name, _value(rng, field, depth, odd))
    return message


def _value(rng: random.Random, field: Any, depth: int, odd: float) -> Any:
    if field.message_type is not None and field.message_type.full_name == _ANY:
        packed = AnyMessage()
        packed.Pack(PoseSpeed(map_id=rng.randrange(2**32)))
        return packed
    if field.message_type is not None:
        return filled(rng, message_types()[field.message_type.full_name], depth + 1, odd)
    kind = field.cpp_type
    if kind == Kind.CPPTYPE_BOOL:
        return rng.random() < 0.7
    if kind in (Kind.CPPTYPE_FLOAT, Kind.CPPTYPE_DOUBLE):
        if rng.random() < odd:
            return rng.choice(_ODD_FLOATS)
        return rng.choice(_FLOATS) if rng.random() < 0.3 else rng.uniform(-20.0, 20.0)
    if kind == Kind.CPPTYPE_ENUM:
        numbers = [value.number for value in field.enum_type.values]
        return rng.choice(numbers) if rng.random() < 0.9 else rng.randint(-(2**31), 2**31 - 1)
    if kind == Kind.CPPTYPE_STRING:
        return rng.choice(_BYTES if field.type == Kind.TYPE_BYTES else _STRINGS)
    low, high = _RANGES[kind]
    return rng.choice((low, high, 0, 1, 2, rng.randint(0, 100), rng.randint(low, high)))


@cache
def type_names() -> tuple[str, ...]:
    """Return the names of all types, those that the chassis answers first."""
    return (*sorted(HANDLERS), *sorted(message_types()))


def request(rng: random.Random) -> tuple[str, Message]:
    """Return a request, in most cases of a type that the chassis answers."""
    name = rng.choice(sorted(HANDLERS)) if rng.random() < 0.95 else rng.choice(type_names())
    return name, filled(rng, message_types()[name])


def frame(rng: random.Random, codec: JsonCodec | ProtobufCodec) -> Any:
    """Return a valid frame."""
    name, body = request(rng)
    return codec.encode(
        name, body, sn=rng.choice((0, 1, 7, 2**31 - 1)), ok=rng.choice((None, True)), msg="ü"
    )


@cache
def _corpus(encoding: str) -> tuple[Any, ...]:
    """Return the valid frames that are mutated. They are constant, and costly to generate."""
    rng = random.Random("corpus")
    codec = JsonCodec(defaults=True) if encoding == "json" else ProtobufCodec()
    found = [frame(rng, codec) for _ in range(1500)]
    found = [each for each in found if len(each) < 20_000]
    return (*DOCUMENTED, *found) if encoding == "json" else tuple(found)


def text(rng: random.Random) -> str:
    """Return a JSON frame: one in ten is valid, the others are mutated in one to four places."""
    data: str = rng.choice(_corpus("json"))
    if rng.random() < 0.1:
        return data
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        data = rng.choice(_TEXT_MUTATIONS)(rng, data)
    return data


def blob(rng: random.Random) -> bytes:
    """Return a protobuf frame: one in ten is valid, the others are mutated in 1 to 4 places."""
    data: bytes = rng.choice(_corpus("protobuf"))
    if rng.random() < 0.1:
        return data
    pack = MessagePackJson.FromString(data)
    body_only = rng.random() < 0.5
    if body_only:
        data = pack.body.value
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        data = rng.choice(_BLOB_MUTATIONS)(rng, data)
    if body_only:
        pack.body.value = data
        data = pack.SerializeToString()
    return data


def _span(rng: random.Random, data: Any) -> tuple[int, int]:
    start = rng.randint(0, len(data))
    return start, min(len(data), start + rng.choice((0, 1, 2, 5, 20, 200)))


def _cut(rng: random.Random, data: Any) -> Any:
    return data[: rng.randint(0, len(data))]


def _remove(rng: random.Random, data: Any) -> Any:
    start, end = _span(rng, data)
    return data[:start] + data[end:]


def _repeat(rng: random.Random, data: Any) -> Any:
    start, end = _span(rng, data)
    return data[:end] + data[start:end] * rng.choice((1, 2, 50)) + data[end:]


def _spliced(other: Callable[[], tuple[Any, ...]]) -> Callable[[random.Random, Any], Any]:
    def splice(rng: random.Random, data: Any) -> Any:
        start, end = _span(rng, data)
        found = rng.choice(other())
        first, last = _span(rng, found)
        return data[:start] + found[first:last] + data[end:]

    return splice


def _insert_token(rng: random.Random, data: str) -> str:
    start, end = _span(rng, data)
    return data[:start] + rng.choice(_TOKENS) + data[end:]


def _change_a_value(rng: random.Random, data: str) -> str:
    """Replace one value or one name in the frame by an unusual one."""
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return _insert_token(rng, data)
    places: list[tuple[Any, Any]] = []
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        keys: Any = ()
        if isinstance(node, dict):
            keys = list(node)
        elif isinstance(node, list):
            keys = range(min(len(node), 20))
        for key in keys:
            places.append((node, key))
            waiting.append(node[key])
    if not places:
        return rng.choice(_NASTY)
    mark = "\x01fuzz\x01"
    node, key = rng.choice(places)
    if isinstance(node, dict) and rng.random() < 0.15:
        node[rng.choice(_STRINGS[:8])] = node.pop(key)  # an unknown name
        return json.dumps(tree)
    node[key] = mark
    odd = rng.choice(_NASTY)
    if rng.random() < 0.0005:
        opening, closing = rng.choice((("[", "]"), ('{"a":', "}"), ('{"twist":', "}")))
        odd = opening * _DEEP + "1" + closing * _DEEP
    return json.dumps(tree).replace(json.dumps(mark), odd)


def _flip(rng: random.Random, data: bytes) -> bytes:
    if not data:
        return b"\0"
    at = rng.randrange(len(data))
    return data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]


def _insert_bytes(rng: random.Random, data: bytes) -> bytes:
    start, end = _span(rng, data)
    odd = rng.choice(
        (b"\xff" * 10, b"\xff" * 9 + b"\x01", b"\x80" * 11, b"\0", b"\x0b\x0c", b"\x0f",
         b"\xfa\x06", b"\x08\xff\xff\xff\xff\x0f", rng.randbytes(rng.choice((1, 2, 8, 60))))
    )  # fmt: skip
    if rng.random() < 0.0005:
        odd = rng.choice((b"\x0b", b"\x0a\x7f")) * _DEEP  # groups and messages that do not end
    return data[:start] + odd + data[end:]


_TEXT_MUTATIONS: tuple[Callable[[random.Random, str], str], ...] = (
    *((_change_a_value,) * 6),
    *(_insert_token, _cut, _remove, _repeat),
    _spliced(lambda: _corpus("json")),
)
_BLOB_MUTATIONS: tuple[Callable[[random.Random, bytes], bytes], ...] = (
    *(_flip, _flip, _insert_bytes, _cut, _remove, _repeat),
    _spliced(lambda: _corpus("protobuf")),
)
