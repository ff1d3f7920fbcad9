"""Names of the fields of messages, in the schemas and in messages."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from woosh_robot_agent.vda5050.messages.reading import SCHEMAS

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
