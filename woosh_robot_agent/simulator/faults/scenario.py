"""Faults by schedule: from the command line and from YAML files."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from woosh_robot_agent.simulator.faults.parameters import FaultError, Parameter
from woosh_robot_agent.simulator.faults.table import find

_AT = Parameter("at", float, 0.0, "when it happens", unit="simulated s", low=0.0)


@dataclass(frozen=True)
class Step:
    """One fault at its time.

    Attributes:
        at: Simulated s after the start.
        name: That of the fault.
        arguments: All of its arguments, by name.
    """

    at: float
    name: str
    arguments: Mapping[str, Any]


@dataclass(frozen=True)
class Scenario:
    """Faults that happen by themselves.

    Attributes:
        steps: In any order; those of one time happen in the order in which they stand here.
    """

    steps: tuple[Step, ...] = ()

    def __add__(self, other: Scenario) -> Scenario:
        """The faults of both."""
        return Scenario(self.steps + other.steps)


def step(name: str, **arguments: object) -> Step:
    """A fault with its arguments, `at` among them.

    Raises:
        FaultError: There is none of this name, or an argument is wrong.
    """
    resolved = find(name).resolve(arguments, also=(_AT,))
    return Step(resolved.pop("at"), name, resolved)


def parse_fault(text: str) -> Step:
    """A fault as it is written on the command line: `NAME key=value ... at=5 for=10`.

    Values with spaces stand in quotes, as in a shell.

    Raises:
        FaultError: There is none of this name, or an argument is wrong.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise FaultError(f"fault {text!r}: {error}") from None
    name, words = (words[0], words[1:]) if words else ("", [])
    parameters = {parameter.name: parameter for parameter in (*find(name).parameters, _AT)}
    arguments: dict[str, object] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals:
            raise FaultError(f"{name}: {word!r} is not of the form key=value")
        if key in arguments:
            raise FaultError(f"{name}: {key} is said twice")
        # An unknown one is complained of below, as everywhere.
        arguments[key] = parameters[key].parse(value) if key in parameters else value
    return step(name, **arguments)


def load_scenario(path: str | Path) -> Scenario:
    """The faults of a YAML file: a list of `{at: SECONDS, do: NAME, ...}`.

    Raises:
        OSError: The file cannot be read.
        FaultError: It is not such a list; the text says which entry is wrong, and why.
    """
    try:
        entries = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise FaultError(f"{path}: not YAML: {error}") from None
    if not isinstance(entries, list):
        raise FaultError(f"{path}: not a list of {{at: SECONDS, do: NAME}}")
    steps = []
    for number, entry in enumerate(entries, 1):
        try:
            steps.append(_entry(entry))
        except FaultError as error:
            raise FaultError(f"{path}: entry {number}: {error}") from None
    return Scenario(tuple(steps))


def _entry(entry: object) -> Step:
    if not isinstance(entry, dict) or not all(isinstance(key, str) for key in entry):
        raise FaultError(f"{entry!r} is not of the form {{at: SECONDS, do: NAME}}")
    arguments = dict(entry)
    name = arguments.pop("do", None)
    if name is False:  # YAML takes the word off for that
        name = "off"
    if not isinstance(name, str):
        raise FaultError("`do` has to name a fault")
    if "at" not in arguments:
        raise FaultError(f"{name}: `at` has to say when, in simulated s after the start")
    return step(name, **arguments)
