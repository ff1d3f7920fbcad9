"""Files as checked dataclasses: what is read, and what the errors say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any, Literal, NamedTuple

import pytest

from woosh_robot_agent.data_files import (
    Between,
    DataFileError,
    NotNegative,
    load_yaml,
    source_field,
    structure,
)


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


class Size(NamedTuple):
    width: float
    height: float


@dataclass(frozen=True)
class Part:
    name: str
    length: NotNegative = 1.0
    where: str = source_field()


@dataclass(frozen=True)
class Box:
    name: str
    size: Size
    count: Annotated[int, Between(1, 9)] = 1
    colour: Colour = Colour.RED
    kind: Literal["flat", "deep"] = "flat"
    is_open: bool = False
    parts: Annotated[tuple[Part, ...], Between(0, 2)] = ()
    rows: tuple[tuple[float, ...], ...] = ()
    prices: Mapping[str, float] | None = None
    notes: Any = None

    def __post_init__(self) -> None:
        if self.is_open and self.count > 1:
            raise ValueError("only a single box can be open")


def box(text: str, *, known_only: bool = True) -> Box:
    required = {"name: ": "name: a, ", "size: ": "size: [1, 2.5], "}
    head = "".join(each for key, each in required.items() if not text.startswith(key))
    data = load_yaml("box.yaml", f"{{{head}{text}}}".encode())
    return structure(Box, data, "box.yaml", known_only=known_only)


def test_all_kinds_of_values_are_read() -> None:
    found = box(
        "count: 3, colour: blue, kind: deep, parts: [{name: lid}, {name: pin, length: 2}],"
        "prices: {eur: 3}, notes: [1, {x: y}]"
    )
    assert (found.size, found.count, found.colour, found.kind) == ((1, 2.5), 3, Colour.BLUE, "deep")
    assert found.parts == (Part("lid"), Part("pin", 2.0))
    assert [part.where for part in found.parts] == ["box.yaml: parts[0]", "box.yaml: parts[1]"]
    assert (found.prices, found.notes) == ({"eur": 3.0}, [1, {"x": "y"}])


def test_an_empty_value_stands_for_the_default() -> None:
    assert box("count: , colour: null, prices: null") == box("")


def test_unknown_keys_are_ignored_on_request() -> None:
    assert box("added: 1, parts: [{name: b, more: 2}]", known_only=False).parts == (Part("b"),)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("cuont: 3", "box.yaml: unknown key 'cuont'; use one of name, size, count, colour, kind,"),
        ("null: 3", "box.yaml: unknown key None; use one of name, size, count, colour, kind,"),
        ("count: 10", "box.yaml: count: must be a whole number from 1 to 9, not 10"),
        ("count: true", "box.yaml: count: must be a whole number, not True"),
        ("count: 1.0", "box.yaml: count: must be a whole number, not 1.0"),
        ("colour: green", "box.yaml: colour: 'green' is not one of red, blue"),
        ("kind: [flat]", "box.yaml: kind: ['flat'] is not one of flat, deep"),
        ("is_open: 1", "box.yaml: is_open: must be true or false, not 1"),
        ("is_open: true, count: 2", "box.yaml: only a single box can be open"),
        ("name: 7", "box.yaml: name: must be a text, not 7; put numbers into quotes"),
        ("size: [1]", "box.yaml: size: must be [width, height], not [1]"),
        ("size: [1, .nan]", "box.yaml: size[1]: must be a number, not nan"),
        ("size: [1, 1e400]", "box.yaml: size[1]: must be a number, not '1e400'"),
        (f"size: [1, {'9' * 400}]", "box.yaml: size[1]: must be a number, not 9999"),
        ("parts: {}", "box.yaml: parts: must be a list"),
        ("parts: [3]", "box.yaml: parts[0]: must be a mapping of keys to values"),
        ("parts: [{length: 3}]", "box.yaml: parts[0]: name is missing"),
        (
            "parts: [{name: b, length: -1}]",
            "box.yaml: parts[0].length: must be a number of at least 0, not -1.0",
        ),
        (
            "parts: [{name: b}, {name: b}, {name: b}]",
            "box.yaml: parts: has 3 entries, which is more than 2",
        ),
        ("prices: {eur: x}", "box.yaml: prices.eur: must be a number, not 'x'"),
        ("prices: {1: 2}", "box.yaml: prices: the key 1 must be a text"),
    ],
)
def test_errors_name_the_place_and_what_is_allowed(text: str, said: str) -> None:
    with pytest.raises(DataFileError) as caught:
        box(text)
    assert str(caught.value).startswith(said)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: [1", "box.yaml: not readable as YAML: "),
        ("day: 2025-02-31", "box.yaml: not readable as YAML: day is out of range for month"),
        ('a: !!int ""', "box.yaml: not readable as YAML: "),
        ("a: !!bool x", "box.yaml: not readable as YAML: "),
        ("a: !!timestamp x", "box.yaml: not readable as YAML: "),
        ("[" * 21 + "]" * 21, "box.yaml: nested more than 20 levels deep"),
        ("a: {b: 1, c: 2, b: 3}", "box.yaml: not readable as YAML: the key b is used twice in"),
        ("1: a\n'1': b\n1: c", "box.yaml: not readable as YAML: the key 1 is used twice in"),
        ("a: &x {b: 1}\nc: {<<: *x}", "box.yaml: not readable as YAML: merge keys (<<) are not"),
        ("a" * 300_000, "box.yaml: the file has 300000 bytes, more than 262144"),
    ],
)
def test_files_that_cannot_be_read(text: str, said: str) -> None:
    with pytest.raises(DataFileError) as caught:
        load_yaml("box.yaml", text.encode())
    assert str(caught.value).startswith(said)


def test_aliases_do_not_expand_a_file_without_limit() -> None:
    row = ", ".join(["0"] * 1000)
    with pytest.raises(DataFileError, match="more than 200000 values; use fewer aliases"):
        box(f"rows: [&row [{row}]{', *row' * 200}]")
    assert len(box(f"rows: [&row [{row}]{', *row' * 100}]").rows) == 101
