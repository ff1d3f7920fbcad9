"""The table of all faults; command line, scenario files, Python and the documentation go by it."""

from __future__ import annotations

from woosh_robot_agent.simulator.faults import (
    answer_faults,
    chassis_faults,
    frame_faults,
    link_faults,
)
from woosh_robot_agent.simulator.faults.fault import Fault
from woosh_robot_agent.simulator.faults.parameters import FaultError, Parameter

#: Every fault, by its name.
FAULTS: dict[str, Fault] = {
    fault.name: fault
    for module in (link_faults, answer_faults, frame_faults, chassis_faults)
    for fault in module.FAULTS
}


def find(name: str) -> Fault:
    """The fault of a name.

    Raises:
        FaultError: There is none.
    """
    try:
        return FAULTS[name]
    except KeyError:
        raise FaultError(f"no fault {name!r}; there are: {', '.join(FAULTS)}") from None


def markdown() -> str:
    """The whole table in Markdown."""
    rows = [("Fault", "What it does", "Lasts", "Arguments"), ("---",) * 4]
    for fault in FAULTS.values():
        arguments = "<br>".join(_argument(parameter) for parameter in fault.own)
        lasts = "until it ends" if fault.lasting else "momentary"
        rows.append((f"`{fault.name}`", fault.description, lasts, arguments))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _argument(parameter: Parameter) -> str:
    default = parameter.default
    if default is None:
        said = "left out"
    elif isinstance(default, float):
        said = f"{default:g}"
    else:
        said = str(default) or "empty"
    return f"`{parameter.name}` ({parameter.allowed}, default {said}): {parameter.description}"
