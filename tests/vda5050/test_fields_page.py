"""docs/vda5050_fields.md: its tables have the fields of the schemas, and tell what is sent."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.vda5050.fields import message_fields, schema_fields, topics
from tests.vda5050.samples import FACTSHEET, ROBOT, STATE
from woosh_robot_agent.vda5050.messages.state import ConnectionState
from woosh_robot_agent.vda5050.messages.versions import V2_1, V3_0, Version
from woosh_robot_agent.vda5050.messages.writing import (
    connection_message,
    factsheet_message,
    state_message,
    visualization_message,
)

PAGE = (Path(__file__).parents[2] / "docs/vda5050_fields.md").read_text("utf-8")
VERSIONS: list[Version] = [V2_1, V3_0]
CASES = [(version, topic) for version in VERSIONS for topic in topics(version.number)]


def _rows(version: Version, topic: str) -> list[tuple[str, str]]:
    """Fields of a version in the table of a topic, and what the vehicle does with them."""
    (section,) = re.findall(rf"^## `{topic}`$(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    column = VERSIONS.index(version)
    rows = [line.strip("| ").split(" | ") for line in section.splitlines() if "`" in line[:40]]
    cells = [(row[column].strip("`"), row[2]) for row in rows if len(row) == 3]
    return [(name, text) for name, text in cells if name != "—"]


def _covered(pattern: str, fields: list[str]) -> list[str]:
    if not pattern.endswith(".*"):
        return [pattern]
    top = pattern.removesuffix(".*")
    return [name for name in fields if name == top or name.startswith(f"{top}.")]


def _id(value: object) -> str:
    return value if isinstance(value, str) else str(getattr(value, "number", ""))


@pytest.mark.parametrize(("version", "topic"), CASES, ids=_id)
def test_the_table_has_the_fields_of_the_schema(version: Version, topic: str) -> None:
    fields = schema_fields(version.number, topic)
    listed = [name for row, _ in _rows(version, topic) for name in _covered(row, fields)]
    assert sorted(listed) == sorted(fields)


@pytest.mark.parametrize(
    ("version", "topic"),
    [case for case in CASES if case[1] in ("connection", "factsheet", "state", "visualization")],
    ids=_id,
)
def test_the_table_tells_which_fields_are_sent(version: Version, topic: str) -> None:
    fields = schema_fields(version.number, topic)
    message = {
        "connection": lambda: connection_message(version, ConnectionState.ONLINE),
        "factsheet": lambda: factsheet_message(version, FACTSHEET),
        "state": lambda: state_message(version, STATE),
        "visualization": lambda: visualization_message(version, ROBOT, 0),
    }[topic]()
    sent = {
        name
        for row, text in _rows(version, topic)
        if text.startswith("yes")
        for name in _covered(row, fields)
    }
    assert sent == set(message_fields(message))
