"""The factsheet: properties and capabilities of a vehicle. Checks actions against them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeAlias

from woosh_robot_agent.sentences import Sentence, joined
from woosh_robot_agent.vda5050.messages.order import Action, BlockingType

STANDSTILL = frozenset({BlockingType.SOFT, BlockingType.HARD})
"""Blocking types for actions that need a standing vehicle."""


class Scope(Enum):
    """Places where an action may be requested."""

    INSTANT = "INSTANT"
    NODE = "NODE"
    EDGE = "EDGE"


@dataclass(frozen=True)
class Objection:
    """A reason why the vehicle cannot perform an action.

    Attributes:
        parameter: key of the unknown, wrong or missing parameter; empty for another reason.
    """

    reason: str
    parameter: str = ""

    @property
    def references(self) -> dict[str, str]:
        """The `errorReferences` that the objection adds to its error."""
        return {"actionParameter": self.parameter} if self.parameter else {}


_OR = Sentence("{one} or {other}")
_FINITE = Sentence("a finite number")()
_TEXT = Sentence("a text")()
NOT_EMPTY = Sentence("a text that is not empty")()
_TRUTH = Sentence("true or false")()
_AT_LEAST = Sentence("at least {least}")
_WITHIN = Sentence("within {least} to {greatest}")
_ONE_OF = Sentence("one of {choices}")
_WRONG_SCOPE = Sentence("{action} is not possible as {place} action, only as {places} action")
_BLOCKING = Sentence("{action} needs blockingType {types}, not {given}")
_UNKNOWN_KEY = Sentence("{action} has no parameter {key}")
_MISSING_KEY = Sentence("{action} needs the parameter {key}")
_WRONG_VALUE = Sentence("the parameter {key} of {action} must be {allowed}")
_SCOPES = {each: Sentence(each.value.lower())() for each in Scope}
_NO_ACTION = Sentence("the vehicle has no action {action}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


_DATA_TYPES: dict[str, tuple[Callable[[Any], bool], str]] = {
    "FLOAT": (_is_number, _FINITE),
    "STRING": (lambda value: isinstance(value, str), _TEXT),
    "BOOL": (lambda value: isinstance(value, bool), _TRUTH),
}
"""Check of a value, and description of the valid values, by data type."""


@dataclass(frozen=True)
class ParameterType:
    """A parameter of an action.

    Attributes:
        type: data type: FLOAT, STRING or BOOL.
        optional: True if the parameter may be left out.
        valid: returns True for a valid value of the data type; None if all values are valid.
        must_be: description of the values for which `valid` returns True.
    """

    key: str
    type: str
    description: str
    optional: bool = False
    valid: Callable[[Any], bool] | None = None
    must_be: str = ""

    def broken_rule(self, value: Any) -> str:
        """Return the description of the valid values, or an empty text if the value is valid."""
        has_type, description = _DATA_TYPES[self.type]
        if not has_type(value):
            return description
        return "" if self.valid is None or self.valid(value) else self.must_be


def number(
    key: str, description: str, lowest: float, highest: float = math.inf, *, optional: bool = False
) -> ParameterType:
    """Return the type of a parameter that is a number from `lowest` to `highest`, both included."""
    limits = _AT_LEAST(least=f"{lowest:g}")
    if highest < math.inf:
        limits = _WITHIN(least=f"{lowest:g}", greatest=f"{highest:g}")
    return ParameterType(
        key, "FLOAT", description, optional, lambda value: lowest <= value <= highest, limits
    )


def choice(key: str, choices: Collection[str]) -> ParameterType:
    """Return the type of a parameter that is one of some texts."""
    text = _ONE_OF(choices=", ".join(choices))
    return ParameterType(key, "STRING", text, valid=lambda value: value in choices, must_be=text)


@dataclass(frozen=True)
class ActionType:
    """An action that the vehicle can perform.

    Attributes:
        name: name of the action, e.g. `pick`.
        scopes: where the action may be requested.
        result: meaning of the result; empty for an action without a result.
        blocking: blocking types that the action may have on nodes and edges.
        moves: True if the action moves something, so that it is paused with the vehicle, and can be
            cancelled while it runs.
        repeatable: True if an instant action may repeat the id of an instant action that has ended.
    """

    name: str
    scopes: frozenset[Scope]
    description: str
    parameters: tuple[ParameterType, ...] = ()
    result: str = ""
    blocking: frozenset[BlockingType] = frozenset(BlockingType)
    moves: bool = False
    repeatable: bool = False

    @property
    def controls_vehicle(self) -> bool:
        """True if the action controls the vehicle itself, and waits for no other action."""
        return self.scopes == {Scope.INSTANT}


ActionTypes: TypeAlias = Mapping[str, ActionType]
"""The actions of a vehicle, by name."""


def find_objection(types: ActionTypes, action: Action, scope: Scope) -> Objection | None:
    """Return why the vehicle cannot perform an action; None if the action is possible."""
    if action.type not in types:
        return Objection(_NO_ACTION(action=action.type))
    kind = types[action.type]
    if scope not in kind.scopes:
        places = joined(_OR, sorted(_SCOPES[each] for each in kind.scopes))
        return Objection(_WRONG_SCOPE(action=kind.name, place=_SCOPES[scope], places=places))
    if scope is not Scope.INSTANT and action.blocking not in kind.blocking:
        permitted = joined(_OR, sorted(each.value for each in kind.blocking))
        blocking = action.blocking.value
        return Objection(_BLOCKING(action=kind.name, types=permitted, given=blocking))
    given, known = action.parameters, {each.key: each for each in kind.parameters}
    for key in given:
        if key not in known:
            return Objection(_UNKNOWN_KEY(action=kind.name, key=key), key)
    for key, parameter in known.items():
        if key not in given:
            if not parameter.optional:
                return Objection(_MISSING_KEY(action=kind.name, key=key), key)
        elif allowed := parameter.broken_rule(given[key]):
            return Objection(_WRONG_VALUE(action=kind.name, key=key, allowed=allowed), key)
    return None


@dataclass(frozen=True)
class Limits:
    """Intervals and content of the messages.

    Attributes:
        min_state_interval: minimum time between two states, in seconds.
        state_interval: maximum time between two states, in seconds.
        visualization_interval: time between two visualizations while the robot moves, in seconds.
        driving_state_interval: maximum time between two states while the robot moves, in seconds;
            0 for `state_interval`.
        maps_in_state: True if the state lists the maps on the robot.
    """

    min_state_interval: float = 0.1
    state_interval: float = 30.0
    visualization_interval: float = 1.0
    driving_state_interval: float = 0.0
    maps_in_state: bool = True


@dataclass(frozen=True)
class Factsheet:
    """Properties and capabilities of a vehicle. Lengths are in metres, masses in kilograms.

    Attributes:
        kinematics: `agvKinematic` in version 2.1: DIFF or OMNI.
        vehicle_class: `agvClass`, e.g. CARRIER.
        max_load: maximum mass of the load.
        outline: corners of the outline, as x and y in the vehicle's frame; empty if unknown.
        versions: versions of the vehicle's software, by name.
    """

    series: str
    description: str
    kinematics: str
    vehicle_class: str
    max_load: float
    length: float
    width: float
    height: float
    limits: Limits
    outline: tuple[tuple[float, float], ...]
    actions: tuple[ActionType, ...]
    versions: tuple[tuple[str, str], ...] = ()
