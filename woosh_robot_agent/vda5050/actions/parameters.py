"""Check of the parameters of actions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from woosh_robot_agent.vda5050.actions.errors import Objection
from woosh_robot_agent.vda5050.model.factsheet import ActionType


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


_CHECKS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "FLOAT": (_is_number, "a finite number"),
    "STRING": (lambda value: isinstance(value, str) and bool(value), "a text that is not empty"),
    "BOOL": (lambda value: isinstance(value, bool), "true or false"),
}
"""Functions that return True for a valid value, and descriptions of valid values, by data type."""


def parameter_objection(kind: ActionType, given: Mapping[str, Any]) -> Objection | None:
    """Return what is wrong with the parameters of an action; None if they have the right types.

    Args:
        kind: the type of the action.
        given: values by key.
    """
    known = {each.key: each for each in kind.parameters}
    for key in given:
        if key not in known:
            return Objection(f"{kind.name} has no parameter {key}", key)
    for key, parameter in known.items():
        if key not in given:
            if not parameter.optional:
                return Objection(f"{kind.name} needs the parameter {key}", key)
            continue
        is_valid, description = _CHECKS[parameter.type]
        if not is_valid(given[key]):
            return Objection(f"the parameter {key} of {kind.name} must be {description}", key)
    return None


def range_objection(
    given: Mapping[str, Any], key: str, lowest: float, highest: float = math.inf
) -> Objection | None:
    """Return what is wrong with an optional number; None if it is missing or within its range.

    Args:
        given: values by key.
        key: key of the parameter.
        lowest: smallest permitted value.
        highest: greatest permitted value.
    """
    if key not in given or lowest <= given[key] <= highest:
        return None
    limits = f"at least {lowest:g}" if highest == math.inf else f"within {lowest:g} to {highest:g}"
    return Objection(f"the parameter {key} must be {limits}, not {given[key]:g}", key)
