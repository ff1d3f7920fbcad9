"""Strategies for random messages of any type, and the message types in the table of endpoints."""

from __future__ import annotations

import math
import re
from typing import Any

from google.protobuf.any_pb2 import Any as AnyMessage
from google.protobuf.descriptor import FieldDescriptor as Kind
from google.protobuf.message import Message
from hypothesis import strategies as st

from tests.fact_files import facts
from woosh_robot_agent.link.protos import message_types
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed

ENDPOINTS = facts("endpoints.yaml")


def table_types() -> list[str]:
    """Return the full names of all messages in the table of endpoints."""
    found = set()
    for group in ENDPOINTS.values():
        for endpoint in group.values() if isinstance(group, dict) else ():
            for key in ("request", "answer", "push", "feedback"):
                found |= set(re.findall(r"woosh\.[\w.]*\w", str(endpoint.get(key, ""))))
    return sorted(found)


_INTEGERS = {
    Kind.TYPE_INT32: (-(2**31), 2**31 - 1),
    Kind.TYPE_ENUM: (-(2**31), 2**31 - 1),
    Kind.TYPE_UINT32: (0, 2**32 - 1),
    Kind.TYPE_FIXED32: (0, 2**32 - 1),
    Kind.TYPE_INT64: (-(2**63), 2**63 - 1),
    Kind.TYPE_UINT64: (0, 2**64 - 1),
}
_OTHERS = {
    Kind.TYPE_BOOL: st.booleans(),
    Kind.TYPE_STRING: st.text(max_size=8),
    Kind.TYPE_BYTES: st.binary(max_size=8),
    Kind.TYPE_FLOAT: st.floats(width=32, allow_nan=False) | st.just(math.nan),
    Kind.TYPE_DOUBLE: st.floats(allow_nan=False) | st.just(math.nan),
}


def values(field: Any, depth: int) -> st.SearchStrategy[Any]:
    if field.message_type is not None:
        if field.message_type.full_name == "google.protobuf.Any":
            return st.builds(packed, st.integers(0, 2**32 - 1))
        return messages(message_types()[field.message_type.full_name], depth + 1)
    if field.type in _INTEGERS:
        low, high = _INTEGERS[field.type]
        ends = [low, high, 0]
        if field.enum_type is not None:
            ends = [value.number for value in field.enum_type.values]
        return st.sampled_from(ends) | st.integers(low, high)
    return _OTHERS[field.type]


def packed(map_id: int) -> AnyMessage:
    message = AnyMessage()
    message.Pack(PoseSpeed(map_id=map_id))
    return message


@st.composite
def messages(draw: st.DrawFn, cls: type[Message], depth: int = 0) -> Message:
    message = cls()
    fields = list(cls.DESCRIPTOR.fields)
    for field in (
        draw(st.lists(st.sampled_from(fields), max_size=max(1, 8 - 3 * depth))) if fields else []
    ):
        repeated = getattr(field, "is_repeated", None)
        if repeated is None:
            repeated = field.label == Kind.LABEL_REPEATED
        if repeated:
            getattr(message, field.name).extend(draw(st.lists(values(field, depth), max_size=3)))
        elif field.message_type is not None:
            getattr(message, field.name).CopyFrom(draw(values(field, depth)))
        else:
            setattr(message, field.name, draw(values(field, depth)))
    return message
