"""The compiled protobuf descriptors match the facts exactly."""

from __future__ import annotations

import importlib
import pkgutil
import re
from typing import Any

import pytest
from google.protobuf.descriptor import FieldDescriptor

from tests.fact_files import facts
from woosh_robot_agent import pb

FACTS = facts("proto/woosh_proto.yaml")
SCALARS = {
    name: getattr(FieldDescriptor, f"TYPE_{name.upper()}")
    for name in ("double", "float", "int64", "uint64", "int32", "uint32", "fixed32", "bool")
    + ("string", "bytes")
}
FILES: dict[str, Any] = {
    descriptor.name: descriptor
    for module in pkgutil.walk_packages(pb.__path__, pb.__name__ + ".")
    if not module.ispkg
    for descriptor in [importlib.import_module(module.name).DESCRIPTOR]
}
LINE = re.compile(
    r"(?P<number>\d+) (?P<repeated>repeated )?(?P<type>\S+) (?P<name>\w+)"
    r"(?: oneof=(?P<oneof>\w+))?(?: json=(?P<json>\w+))?"
)


def expected_field(line: str) -> dict[str, Any]:
    found = LINE.fullmatch(line)
    assert found, line
    camel_case = re.sub(r"_(\w)", lambda letter: letter[1].upper(), found["name"])
    return {
        "number": int(found["number"]),
        "repeated": bool(found["repeated"]),
        "type": found["type"],
        "name": found["name"],
        "oneof": found["oneof"],
        "json": found["json"] or camel_case,
    }


def actual_field(field: Any) -> dict[str, Any]:
    if field.message_type is not None:
        type_name = field.message_type.full_name
    elif field.enum_type is not None:
        type_name = field.enum_type.full_name
    else:
        (type_name,) = [name for name, number in SCALARS.items() if number == field.type]
    repeated = getattr(field, "is_repeated", None)
    if repeated is None:
        repeated = field.label == FieldDescriptor.LABEL_REPEATED
    return {
        "number": field.number,
        "repeated": repeated,
        "type": type_name,
        "name": field.name,
        "oneof": field.containing_oneof and field.containing_oneof.name,
        "json": field.json_name,
    }


def expected_messages(tree: Any) -> Any:
    return {
        name: {
            "fields": sorted(
                (expected_field(line) for line in message.get("fields") or []),
                key=lambda field: int(field["number"]),
            ),
            "messages": expected_messages(message.get("messages")),
            "enums": expected_enums(message.get("enums")),
        }
        for name, message in (tree or {}).items()
    }


def expected_enums(tree: Any) -> Any:
    return {
        name: {str(key): int(number) for key, number in values.items()}
        for name, values in (tree or {}).items()
    }


def actual_enums(by_name: Any) -> Any:
    return {
        name: {value.name: value.number for value in enum.values} for name, enum in by_name.items()
    }


def actual_messages(by_name: Any) -> Any:
    return {
        name: {
            "fields": sorted(map(actual_field, message.fields), key=lambda field: field["number"]),
            "messages": actual_messages(message.nested_types_by_name),
            "enums": actual_enums(message.enum_types_by_name),
        }
        for name, message in by_name.items()
    }


def test_the_files_match_the_facts() -> None:
    assert set(FILES) == set(FACTS)


@pytest.mark.parametrize("path", sorted(FACTS))
def test_each_file_matches_the_facts_exactly(path: str) -> None:
    fact, file = FACTS[path], FILES[path]

    assert file.package == fact["package"]
    assert {one.name for one in file.dependencies} == set(fact["imports"])
    assert actual_messages(file.message_types_by_name) == expected_messages(fact["messages"])
    assert actual_enums(file.enum_types_by_name) == expected_enums(fact["enums"])
    assert not file.services_by_name
    assert not file.extensions_by_name
