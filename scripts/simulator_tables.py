"""Tables of docs/simulator_reference.md: profile fields, refusals, scene keys, requests."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator

from scripts.markdown_table import table
from woosh_robot_agent.simulator.profile import SHIPPED_FOLDER
from woosh_robot_agent.simulator.protocol.handlers import COMMANDS, HANDLERS, QUERIES
from woosh_robot_agent.simulator.protocol.reports import TOPICS
from woosh_robot_agent.simulator.refusals import REFUSALS, REQUEST_FAILED
from woosh_robot_agent.simulator.scenes import scene_yaml

_PROFILE_LINE = re.compile(
    r"(?P<group>\w+):$|  # (?P<comment>.+)$|  (?P<key>\w+):(?P<value> .+)?$|    .*|$"
)
"""Line of tr200.yaml: a group, a comment, a key of the group, a deeper line (ignored), or empty."""

_ATTRIBUTE = re.compile(r"^    (\w+): (.+(?:\n {8,}.+)*)", re.M)
"""An attribute in a docstring: its name and its description."""


def profile_table() -> str:
    """Return the fields of a profile as a Markdown table, from the comments in tr200.yaml.

    A comment describes the fields up to the next comment.

    Raises:
        ValueError: a line of the file cannot be read, or a field has no comment.
    """
    rows: list[tuple[str, list[str], list[str]]] = []  # comment, keys, values
    group = ""
    after_comment = False
    for line in (SHIPPED_FOLDER / "tr200.yaml").read_text("utf-8").splitlines():
        if line.startswith("# "):
            continue
        found = _PROFILE_LINE.fullmatch(line)
        if found is None:
            raise ValueError(f"cannot read this line of tr200.yaml: {line}")
        if found["group"]:
            group = found["group"]
        elif found["comment"] and after_comment:
            rows[-1] = (f"{rows[-1][0]} {found['comment']}", *rows[-1][1:])
        elif found["comment"]:
            rows.append((found["comment"], [], []))
        elif found["key"]:
            rows[-1][1].append(f"`{group}.{found['key']}`")
            rows[-1][2].append(f"`{found['value'].strip()}`" if found["value"] else "(list)")
        after_comment = bool(found["comment"])
    return table(
        ("Field", "tr200", "Meaning"),
        (("<br>".join(keys), "<br>".join(values), meaning) for meaning, keys, values in rows),
    )


def refusals_table() -> str:
    """Return the refusals with special words or a status code as a Markdown table."""
    rows = []
    for name, each in REFUSALS.items():
        if each.words != REQUEST_FAILED or each.code:
            code = f"{each.code.number}: {each.code.text('en')}" if each.code else ""
            rows.append((name.lower().replace("_", " "), each.words, code))
    return table(("Situation", "Words of the real robot", "Status code"), rows)


def scene_table() -> str:
    """Return the keys of scene.yaml as a Markdown table, from the docstrings of its dataclasses."""
    entries = (
        ("", scene_yaml.SceneEntry),
        ("start.", scene_yaml.StartEntry),
        ("maps[].", scene_yaml.MapEntry),
        ("maps[].marks[].", scene_yaml.MarkEntry),
        ("tasks.", scene_yaml.TasksEntry),
        ("tasks.predefined[].", scene_yaml.TaskSetEntry),
        ("tasks.predefined[].button.", scene_yaml.ButtonEntry),
        ("tasks.predefined[].steps[].", scene_yaml.StepEntry),
    )
    return table(
        ("Key", "Meaning"),
        ((f"`{prefix}{key}`", text) for prefix, entry in entries for key, text in _keys(entry)),
    )


def requests_table() -> str:
    """Return the requests that the simulator answers, and its pushes, as a Markdown table."""
    packages = sorted({_package(name) for name in (*HANDLERS, *TOPICS)})

    def by_package(names: Iterable[str]) -> dict[str, str]:
        short_names: dict[str, list[str]] = defaultdict(list)
        for name in sorted(names):
            short_names[_package(name)].append(name.rpartition(".")[2])
        return {package: ", ".join(each) for package, each in short_names.items()}

    columns = by_package(QUERIES), by_package(COMMANDS), by_package(TOPICS)
    return table(
        ("Package", "Requests that only read", "Requests that may change something", "Pushes"),
        (
            (f"`{package}`", *(column.get(package, "") for column in columns))
            for package in packages
        ),
    )


def _package(name: str) -> str:
    return name.rpartition(".")[0]


def _keys(entry: type) -> Iterator[tuple[str, str]]:
    """Yield the keys of a dataclass and their descriptions.

    Raises:
        ValueError: the docstring does not describe a key.
    """
    described = dict(_ATTRIBUTE.findall(inspect.getdoc(entry) or ""))
    for field in dataclasses.fields(entry):
        if field.name == "source":  # the place of the entry in its file, not a key
            continue
        if field.name not in described:
            raise ValueError(f"the docstring of {entry.__name__} does not describe {field.name}")
        text = " ".join(described[field.name].split())
        yield field.name, text[0].upper() + text[1:]
