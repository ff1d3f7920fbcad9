"""The table of all faults, and how they are written on the command line and in scenarios."""

from __future__ import annotations

import shlex
from pathlib import Path

import yaml

from woosh_robot_agent.simulator.config import Scenario, Step
from woosh_robot_agent.simulator.faults import chassis_faults, link_faults
from woosh_robot_agent.simulator.faults.fault import Argument, Fault, FaultError

FAULTS: dict[str, Fault] = {
    fault.name: fault
    for fault in (
        *link_faults.LINK_FAULTS,
        *link_faults.ANSWER_FAULTS,
        *link_faults.FRAME_FAULTS,
        *chassis_faults.FAULTS,
    )
}
"""All faults, by name."""


def find(name: str) -> Fault:
    """Return the fault called `name`.

    Raises:
        FaultError: There is no such fault.
    """
    try:
        return FAULTS[name]
    except KeyError:
        raise FaultError(f"unknown fault {name!r}: use one of {', '.join(FAULTS)}") from None


def markdown() -> str:
    """Return the table as Markdown."""
    rows = [("Fault", "Effect", "Kind", "Arguments"), ("---",) * 4]
    for fault in FAULTS.values():
        arguments = "<br>".join(_argument(argument) for argument in fault.own)
        kind = "lasting" if fault.lasting else "momentary"
        rows.append((f"`{fault.name}`", fault.description, kind, arguments))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _argument(argument: Argument) -> str:
    default = argument.default
    if default is None:
        text = "none"
    elif isinstance(default, float):
        text = f"{default:g}"
    else:
        text = str(default) or "empty"
    return f"`{argument.name}` ({argument.allowed}, default {text}): {argument.description}"


_AT = Argument("at", float, 0.0, "when it begins", unit="s of simulated time", low=0.0)


def make_step(name: str, **arguments: object) -> Step:
    """Return a step of a scenario, with all defaults filled in.

    Args:
        name: Name of the fault.
        arguments: Arguments of the fault, and `at`.

    Raises:
        FaultError: There is no such fault, or an argument is invalid.
    """
    resolved = find(name).resolve(arguments, extra=(_AT,))
    return Step(resolved.pop("at"), name, resolved)


def parse_fault(text: str) -> Step:
    """Parse a fault of the command line: `NAME key=value ... at=5 for=10`.

    Values with spaces are quoted as in a shell.

    Raises:
        FaultError: There is no such fault, or an argument is invalid.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise FaultError(f"fault {text!r}: {error}") from None
    name, words = (words[0], words[1:]) if words else ("", [])
    taken = {argument.name: argument for argument in (*find(name).takes, _AT)}
    arguments: dict[str, object] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals:
            raise FaultError(f"{name}: {word!r} is not of the form key=value")
        if key in arguments:
            raise FaultError(f"{name}: {key} is given twice")
        # `make_step` rejects unknown keys.
        arguments[key] = taken[key].parse(value) if key in taken else value
    return make_step(name, **arguments)


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario from a YAML file: a list of `{at: SECONDS, do: NAME, ...}`.

    Raises:
        OSError: The file cannot be read.
        FaultError: The file is not such a list. The text names the invalid entry and the reason.
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
    if name is False:  # YAML reads the unquoted word `off` as False
        name = "off"
    if not isinstance(name, str):
        raise FaultError("`do` must name a fault")
    if "at" not in arguments:
        raise FaultError(f"{name}: `at` is missing: give the simulated seconds since the start")
    return make_step(name, **arguments)
