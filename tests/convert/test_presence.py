"""`has_field`: a bit per field, set if the field is to be sent or was received."""

from __future__ import annotations

from typing import Any

import pytest

from tests.convert.random_messages import item_type
from tests.convert.type_pairs import PAIRS
from woosh_robot_agent.convert import converter
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.link.protos import message_type


def _with_presence() -> dict[str, tuple[Any, Any]]:
    """Return all pairs of types, nested ones included, whose ROS message has presence bits."""
    found: dict[str, tuple[Any, Any]] = {}
    waiting = list(PAIRS.values())
    while waiting:
        ros, proto = waiting.pop()
        types = ros.get_fields_and_field_types()
        if "has_field" in types:
            found[proto.DESCRIPTOR.full_name] = (ros, proto)
        for field in proto.DESCRIPTOR.fields:
            if field.message_type and field.name in types:
                kind = item_type(types[field.name]) or types[field.name]
                waiting.append((class_of(kind, "msg"), message_type(field.message_type.full_name)))
    return found


PRESENT = _with_presence()


def bits_of(ros: Any) -> dict[str, int]:
    """Return the presence bit of each field, from the constants of the message."""
    names = [n for n in ros.get_fields_and_field_types() if hasattr(ros, bit_name(n))]
    return {name: getattr(ros, bit_name(name)) for name in names}


def bit_name(field: str) -> str:
    return f"{field.upper()}_FIELD_SET"


def present(message: Any, names: Any) -> set[str]:
    return {name for name in names if message.HasField(name)}


def test_masks_of_all_sizes_are_covered():
    kinds = {ros.get_fields_and_field_types()["has_field"] for ros, _ in PRESENT.values()}
    assert kinds == {"uint8", "uint16", "uint32"}
    assert len(PRESENT) > 20


@pytest.mark.parametrize(("ros", "proto"), PRESENT.values(), ids=PRESENT)
class TestBits:
    def test_bits_match_the_declaration(self, ros: Any, proto: Any):
        fields = proto.DESCRIPTOR.fields_by_name
        assert bits_of(ros) == {name: 1 << fields[name].index for name in bits_of(ros)}

    def test_bits_decide_what_is_sent(self, ros: Any, proto: Any):
        bits = bits_of(ros)
        convert = converter(ros, proto)
        for name, bit in bits.items():
            assert present(convert.to_proto(ros(has_field=bit)), bits) == {name}
            others = ros().has_field & ~bit
            assert present(convert.to_proto(ros(has_field=others)), bits) == bits.keys() - {name}
        assert present(convert.to_proto(ros(has_field=0)), bits) == set()
        assert present(convert.to_proto(ros()), bits) == bits.keys()  # all bits are set
