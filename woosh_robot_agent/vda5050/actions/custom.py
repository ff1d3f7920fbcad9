"""Actions that send any command of the chassis, and the check of the parameters of all actions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak as SpeakRequest
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SwitchFootPrint
from woosh_robot_agent.pb.ros.action_pb2 import LiftControl3, StepControl
from woosh_robot_agent.pb.util import robot_pb2
from woosh_robot_agent.vda5050.actions.performer import PlainPerformer, Report
from woosh_robot_agent.vda5050.actions.robot_calls import Objection
from woosh_robot_agent.vda5050.messages.factsheet import (
    STANDSTILL,
    ActionType,
    ParameterType,
    Scope,
)
from woosh_robot_agent.vda5050.messages.order import Action


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


_ANYWHERE = frozenset({Scope.INSTANT, Scope.NODE, Scope.EDGE})
_NOT_ON_EDGES = frozenset({Scope.INSTANT, Scope.NODE})
_MIN_SPEED = 0.01
"""Lowest speed, in m/s or rad/s."""
_MAX_HEIGHT = 2.0
"""Highest target of the lift, in metres. The robot does not report how high its lift goes."""
_MAX_STEP = 10.0
"""Longest step, in metres."""
_MAX_TURN = 2 * math.pi
"""Widest turn, in radians."""
_FOOTPRINTS = {
    "ORIGINAL": robot_pb2.kOriginal,
    "EXPAND": robot_pb2.kExpand,
    "SPARE": robot_pb2.kSpare,
    "DOCK": robot_pb2.kDock,
}


class Speak(PlainPerformer):
    """Says a text."""

    type = ActionType(
        "speak",
        _ANYWHERE,
        "say a text; the action ends when the robot begins to speak",
        (ParameterType("text", "STRING", "text to say"),),
    )

    async def perform(self, action: Action, report: Report) -> str:
        await self._context.request(SpeakRequest(text=action.parameters["text"]))
        return ""


class LiftTo(PlainPerformer):
    """Moves the lift to a height."""

    type = ActionType(
        "liftTo",
        _ANYWHERE,
        "move the lift to a height",
        (
            ParameterType(
                "height",
                "FLOAT",
                f"height above the lowest position, in m, at most {_MAX_HEIGHT:g}; the robot may "
                "permit less",
            ),
            ParameterType("speed", "FLOAT", "speed, in m/s; the robot's own if missing", True),
        ),
        "report of the robot",
        pausable=True,
    )

    def check(self, action: Action) -> Objection | None:
        given = action.parameters
        return range_objection(given, "height", 0.0, _MAX_HEIGHT) or range_objection(
            given, "speed", 0.001
        )

    async def perform(self, action: Action, report: Report) -> str:
        given = action.parameters
        command = LiftControl3(
            execute_mode=LiftControl3.kAbsolute,
            height=given["height"],
            speed=given.get("speed", 0.0),
        )
        return await self._context.calls.perform(command, report)


class Step(PlainPerformer):
    """Moves the robot straight by a distance."""

    type = ActionType(
        "step",
        _NOT_ON_EDGES,
        "move straight by a distance, measured by odometry",
        (
            ParameterType(
                "distance", "FLOAT", f"distance in m, at most {_MAX_STEP:g}; negative for backwards"
            ),
            ParameterType("speed", "FLOAT", "speed, in m/s; the robot's own if missing", True),
            ParameterType("lateral", "BOOL", "true to move to the left; only on some robots", True),
        ),
        "report of the robot",
        blocking=STANDSTILL,
        pausable=True,
    )

    def check(self, action: Action) -> Objection | None:
        given = action.parameters
        return range_objection(given, "distance", -_MAX_STEP, _MAX_STEP) or range_objection(
            given, "speed", _MIN_SPEED
        )

    async def perform(self, action: Action, report: Report) -> str:
        given = action.parameters
        kind = StepControl.Step
        step = kind(
            mode=kind.kLateral if given.get("lateral", False) else kind.kStraight,
            value=given["distance"],
            speed=given.get("speed", 0.0),
        )
        return await self._context.calls.perform(StepControl(steps=[step]), report)


class Rotate(PlainPerformer):
    """Turns the robot on the spot by an angle."""

    type = ActionType(
        "rotate",
        _NOT_ON_EDGES,
        "turn on the spot by an angle, measured by odometry",
        (
            ParameterType(
                "angle", "FLOAT", "angle in rad, counter-clockwise, at most one turn either way"
            ),
            ParameterType(
                "speed", "FLOAT", "turn rate, in rad/s; the robot's own if missing", True
            ),
        ),
        "report of the robot",
        blocking=STANDSTILL,
        pausable=True,
    )

    def check(self, action: Action) -> Objection | None:
        given = action.parameters
        return range_objection(given, "angle", -_MAX_TURN, _MAX_TURN) or range_objection(
            given, "speed", _MIN_SPEED
        )

    async def perform(self, action: Action, report: Report) -> str:
        given = action.parameters
        step = StepControl.Step(
            mode=StepControl.Step.kRotate, value=given["angle"], speed=given.get("speed", 0.0)
        )
        return await self._context.calls.perform(StepControl(steps=[step]), report)


class SwitchFootprint(PlainPerformer):
    """Changes the outline with which the robot avoids obstacles."""

    type = ActionType(
        "switchFootprint",
        _NOT_ON_EDGES,
        "change the outline with which the robot avoids obstacles, e.g. for a load",
        (ParameterType("footprint", "STRING", f"one of {', '.join(_FOOTPRINTS)}"),),
    )

    def check(self, action: Action) -> Objection | None:
        if action.parameters["footprint"] in _FOOTPRINTS:
            return None
        return Objection(
            f"the parameter footprint must be one of {', '.join(_FOOTPRINTS)}", "footprint"
        )

    async def perform(self, action: Action, report: Report) -> str:
        kind = _FOOTPRINTS[action.parameters["footprint"]]
        await self._context.request(SwitchFootPrint(type=kind))
        return ""
