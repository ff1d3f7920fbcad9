"""The tables of fields in the reference name those of the schemas, and tell what is sent."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from scripts.vda5050_tables import REMARKS, UNSUPPORTED
from tests.vda5050.samples import FACTSHEET, ROBOT, STATE
from woosh_robot_agent.vda5050.messages.reading import SCHEMAS
from woosh_robot_agent.vda5050.messages.state import ConnectionState
from woosh_robot_agent.vda5050.messages.versions import VERSIONS, Version
from woosh_robot_agent.vda5050.messages.writing import (
    connection_message,
    factsheet_message,
    state_message,
    visualization_message,
)

HEADER = ("headerId", "timestamp", "version", "manufacturer", "serialNumber")


def topics(version: str) -> list[str]:
    return sorted(path.stem for path in (SCHEMAS / version).glob("*.schema"))


def schema_fields(version: str, topic: str) -> list[str]:
    """All fields of a message with their paths, without its header, in the sequence of the schema.

    Indices of arrays are left out: `errors.errorType`.
    """
    schema = json.loads((SCHEMAS / version / f"{topic}.schema").read_text("utf-8"))
    names = dict.fromkeys(_schema_fields(schema, schema, ""))
    return [name for name in names if name not in HEADER]


def _schema_fields(root: Any, schema: Any, path: str) -> Iterator[str]:
    if "$ref" in schema:
        resolved = root
        for part in schema["$ref"].removeprefix("#/").split("/"):
            resolved = resolved[part]
        yield from _schema_fields(root, resolved, path)
    if "items" in schema:
        yield from _schema_fields(root, schema["items"], path)
    for name, inner in schema.get("properties", {}).items():
        full = f"{path}.{name}" if path else name
        yield full
        yield from _schema_fields(root, inner, full)


def message_fields(message: Any, path: str = "") -> Iterator[str]:
    """All fields of a message, as `schema_fields`, but with those of the header."""
    if isinstance(message, list):
        for each in message:
            yield from message_fields(each, path)
    if isinstance(message, dict):
        for name, value in message.items():
            full = f"{path}.{name}" if path else name
            yield full
            yield from message_fields(value, full)


SENT: dict[str, Callable[[Version], dict[str, Any]]] = {
    "connection": lambda version: connection_message(version, ConnectionState.ONLINE),
    "factsheet": lambda version: factsheet_message(version, FACTSHEET),
    "state": lambda version: state_message(version, STATE),
    "visualization": lambda version: visualization_message(version, ROBOT, 0),
}
"""Complete messages, by topic."""


def covered(pattern: str, fields: list[str]) -> set[str]:
    top = pattern.removesuffix(".*")
    below = (name for name in fields if name.startswith(f"{top}.")) if pattern != top else ()
    return {top, *below} & set(fields)


@pytest.mark.parametrize("topic", sorted({*UNSUPPORTED, *REMARKS}))
def test_the_tables_name_fields_of_the_schemas(topic: str) -> None:
    known = [
        field
        for version in VERSIONS.values()
        if topic in topics(version.number)
        for field in schema_fields(version.number, topic)
    ]
    listed = [each for patterns in UNSUPPORTED.get(topic, {}).values() for each in patterns]
    for pattern in (*listed, *REMARKS.get(topic, {})):
        assert covered(pattern, known), pattern


@pytest.mark.parametrize("topic", SENT)
@pytest.mark.parametrize("version", VERSIONS.values(), ids=VERSIONS)
def test_all_fields_are_sent_except_those_that_the_table_leaves_out(
    version: Version, topic: str
) -> None:
    fields = schema_fields(version.number, topic)
    sent = set(message_fields(SENT[topic](version)))
    assert sent <= set(fields)
    for patterns in UNSUPPORTED.get(topic, {}).values():
        for pattern in patterns:
            left_out = covered(pattern, fields)
            assert pattern.endswith(".*") or not left_out & sent, pattern
            fields = [name for name in fields if name not in left_out or name in sent]
    assert sorted(fields) == sorted(sent)


@pytest.mark.parametrize("version", VERSIONS.values(), ids=VERSIONS)
def test_the_optional_parameters_are_fields_of_the_order(version: Version) -> None:
    sheet = factsheet_message(version, FACTSHEET)
    names = [each["parameter"] for each in sheet["protocolFeatures"]["optionalParameters"]]
    assert len(names) >= 6
    known = {f"order.{name}" for name in schema_fields(version.number, "order")}
    assert set(names) <= known
