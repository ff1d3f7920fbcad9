"""The table of all faults, for command line, scenario files, Python and documentation."""

from __future__ import annotations

from woosh_robot_agent.simulator.faults import (
    answer_faults,
    chassis_faults,
    frame_faults,
    link_faults,
)
from woosh_robot_agent.simulator.faults.arguments import Argument, FaultError
from woosh_robot_agent.simulator.faults.fault import Fault

FAULTS: dict[str, Fault] = {
    fault.name: fault
    for module in (link_faults, answer_faults, frame_faults, chassis_faults)
    for fault in module.FAULTS
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
