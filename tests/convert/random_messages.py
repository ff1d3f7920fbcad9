"""Random ROS and protobuf messages that the conversion can represent, and JSON that it cannot."""

from __future__ import annotations

import copy
import math
import random
import struct
from collections.abc import Iterator
from typing import Any

from google.protobuf.descriptor import FieldDescriptor as Field

from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.link.codecs.json_codec import is_repeated, is_well_known
from woosh_robot_agent.link.protos import message_type

WIDTHS = {"int8": 8, "uint8": 8, "uint16": 16, "int32": 32, "uint32": 32, "int64": 64, "uint64": 64}
PROTO_INTS = {
    Field.CPPTYPE_INT32: "int32",
    Field.CPPTYPE_UINT32: "uint32",
    Field.CPPTYPE_INT64: "int64",
    Field.CPPTYPE_UINT64: "uint64",
    Field.CPPTYPE_ENUM: "int32",
}
# 0.1f, the smallest float32, and the second largest: ROS's check refuses the largest
FLOATS = (0.0, -0.0, 1.0, 0.10000000149011612, 1.401298464324817e-45, 3.4028232635611926e38)
TEXTS = ("", "A2", "机器人", "ß\u00a0\u2028", "🤖", '"\\/\n\t', "\x7f{}", "null")


def item_type(name: str) -> str | None:
    return name[len("sequence<") : -1] if name.startswith("sequence<") else None


def integer(rng: random.Random, kind: str) -> int:
    bits = WIDTHS[kind]
    low, high = (0, 2**bits - 1) if kind[0] == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return rng.choice([0, 1, low, high, high - 1, rng.randint(low, high)])


def float32(rng: random.Random) -> float:
    value: float = struct.unpack("f", rng.randbytes(4))[0]
    return rng.choice([*FLOATS, value if math.isfinite(value) else 0.5])


def text(rng: random.Random) -> str:
    return "".join(rng.choices(TEXTS, k=rng.randint(0, 3)))


# ROS


def random_ros(rng: random.Random, cls: Any) -> Any:
    """Return a ROS message with random values, presence bits and oneof members."""
    message = cls()
    for name, kind in cls.get_fields_and_field_types().items():
        if name == "which" or name.endswith("_choice"):
            continue
        of = item_type(kind)
        if of is None:
            setattr(message, name, _ros_value(rng, kind))
        else:
            setattr(message, name, [_ros_value(rng, of) for _ in range(rng.randint(0, 2))])
    if is_oneof(cls):
        choice = next(name for name in dir(message) if name.endswith("_choice"))
        # old clients set only one of the two fields
        message.which, old = rng.choice([(0, 1), (1, 0), (1, 1)])
        number = rng.randint(0, len(members(cls)))
        message.which *= number
        setattr(message, choice, old * number)
    return message


def _ros_value(rng: random.Random, kind: str) -> Any:
    if "/" in kind:
        return random_ros(rng, class_of(kind, "msg"))
    if kind == "boolean":
        return rng.random() < 0.5
    if kind == "string":
        return text(rng)
    return float32(rng) if kind == "float" else integer(rng, kind)


def is_oneof(cls: Any) -> bool:
    return "OneOf" in cls.__name__


def members(cls: Any) -> list[str]:
    names = cls.get_fields_and_field_types()
    return [name for name in names if name != "which" and not name.endswith("_choice")]


def carried(message: Any) -> Any:
    """Return a copy without unused bits and values of absent fields, which the conversion drops."""
    result = copy.deepcopy(message)
    cls = type(message)
    number = 0
    if is_oneof(cls):
        choice = next(name for name in dir(message) if name.endswith("_choice"))
        number = message.which or getattr(message, choice)
        result.which = number
        setattr(result, choice, number)
    used = 0
    for name, kind in cls.get_fields_and_field_types().items():
        of = item_type(kind)
        bit = getattr(cls, f"{name.upper()}_FIELD_SET", 0)
        absent = not message.has_field & bit if bit else False
        if is_oneof(cls) and name in members(cls):
            absent = members(cls).index(name) + 1 != number
        used |= bit
        if absent:
            setattr(result, name, blank(getattr(message, name)))
        elif of and "/" in of:
            setattr(result, name, [carried(item) for item in getattr(message, name)])
        elif "/" in kind:
            setattr(result, name, carried(getattr(message, name)))
    if hasattr(message, "has_field"):
        result.has_field &= used
    return result


def blank(value: Any) -> Any:
    """Return the blank value of a type: zero, without presence bits."""
    empty = type(value)()
    if hasattr(empty, "get_fields_and_field_types"):
        for name, kind in empty.get_fields_and_field_types().items():
            if name == "has_field":
                empty.has_field = 0
            elif "/" in kind and not item_type(kind):
                setattr(empty, name, blank(getattr(empty, name)))
    return empty


# Protobuf


def random_proto(rng: random.Random, cls: Any, ros_class: Any) -> Any:
    """Return a protobuf message with random values in all fields that the ROS message has."""
    message = cls()
    types = ros_class.get_fields_and_field_types()
    for group in cls.DESCRIPTOR.oneofs:
        inner = class_of(types[group.name], "msg").get_fields_and_field_types()
        chosen = rng.choice([None, *group.fields])
        if chosen is not None:
            _fill(rng, message, chosen, inner[chosen.name])
    for field in cls.DESCRIPTOR.fields:
        if field.containing_oneof is None and field.name in types and rng.random() < 0.7:
            _fill(rng, message, field, types[field.name])
    return message


def _fill(rng: random.Random, message: Any, field: Any, kind: str) -> None:
    of = item_type(kind)
    repeated = of is not None and field.type != Field.TYPE_BYTES
    values = [_proto_value(rng, field, of or kind) for _ in range(rng.randint(0, 2))]
    if repeated:
        getattr(message, field.name).extend(values)
    elif field.message_type is not None:
        getattr(message, field.name).CopyFrom(_proto_value(rng, field, kind))
    else:
        setattr(message, field.name, _proto_value(rng, field, kind))


def _proto_value(rng: random.Random, field: Any, kind: str) -> Any:
    if field.message_type is not None:
        cls = message_type(field.message_type.full_name)
        return random_proto(rng, cls, class_of(kind, "msg"))
    if field.type == Field.TYPE_BYTES:
        return rng.randbytes(rng.randint(0, 9))
    if field.cpp_type in PROTO_INTS:
        return integer(rng, PROTO_INTS[field.cpp_type])
    if field.cpp_type == Field.CPPTYPE_BOOL:
        return rng.random() < 0.5
    return text(rng) if field.cpp_type == Field.CPPTYPE_STRING else float32(rng)


# JSON with extreme values

HUGE = 10**312
EXTREME_INTEGERS = (HUGE, -HUGE, -1, 2**32 - 1, -(2**63), 2**64)
EXTREMES: dict[int, tuple[Any, ...]] = {
    Field.CPPTYPE_BOOL: (HUGE, -1, math.nan, True),
    Field.CPPTYPE_STRING: (HUGE, math.inf, "\0", "a\ufffdb", "x" * 5000),
    Field.CPPTYPE_ENUM: (HUGE, -1, 2**63 - 1, math.nan, 99, "kNoSuchName"),
    **dict.fromkeys(
        (Field.CPPTYPE_FLOAT, Field.CPPTYPE_DOUBLE),
        (math.inf, math.nan, -1e308, 3e38, HUGE, "NaN"),
    ),
    **dict.fromkeys(
        (Field.CPPTYPE_INT32, Field.CPPTYPE_UINT32, Field.CPPTYPE_INT64, Field.CPPTYPE_UINT64),
        (*EXTREME_INTEGERS, math.inf, math.nan, 1e308, "9" * 312),
    ),
}
"""Extreme values by C++ type of the field."""


def leaves(descriptor: Any, outer: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], int]]:
    """Yield the path of each field that is no message, and its type; a `[]` ends that of a list."""
    for field in descriptor.fields:
        path = (*outer, field.name, *(["[]"] if is_repeated(field) else []))
        if field.message_type is None:
            yield path, field.cpp_type
        elif not is_well_known(field) and len(path) < 9:
            yield from leaves(field.message_type, path)


def body_with(path: tuple[str, ...], value: Any) -> Any:
    """Return a JSON body with `value` at `path`, and no other field."""
    for step in reversed(path):
        value = [value] if step == "[]" else {step: value}
    return value


def merged(one: Any, other: Any) -> Any:
    """Return one JSON body with the fields of another added, also inside of its objects."""
    if isinstance(one, list) and isinstance(other, list):
        return [merged(one[0], other[0])] if one and other else one or other
    if not isinstance(one, dict) or not isinstance(other, dict):
        return other
    return {**one, **{key: merged(one.get(key, {}), value) for key, value in other.items()}}


def extremes(name: str) -> Iterator[Any]:
    """Yield bodies of a type, each with the same extreme value in all fields of one kind."""
    for kind, values in EXTREMES.items():
        paths = [path for path, its in leaves(message_type(name).DESCRIPTOR) if its == kind]
        for value in values if paths else ():
            body: Any = {}
            for path in paths:
                body = merged(body, body_with(path, value))
            yield body
