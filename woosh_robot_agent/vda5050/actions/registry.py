"""All actions of the vehicle."""

from __future__ import annotations

from collections.abc import Callable

from woosh_robot_agent.vda5050.actions.performer import Context, Performer
from woosh_robot_agent.vda5050.actions.requests import CancelOrder, FactsheetRequest, StateRequest
from woosh_robot_agent.vda5050.model.factsheet import ActionType, Scope
from woosh_robot_agent.vda5050.model.order import Action

_PERFORMERS: tuple[Callable[[Context], Performer], ...] = (
    CancelOrder,
    FactsheetRequest,
    StateRequest,
)


class Registry:
    """The actions of a vehicle, by name."""

    def __init__(self, context: Context) -> None:
        performers = [make(context) for make in _PERFORMERS]
        self._performers = {each.type.name: each for each in performers}

    @property
    def types(self) -> tuple[ActionType, ...]:
        """All actions, for the factsheet."""
        return tuple(each.type for each in self._performers.values())

    def get(self, name: str) -> Performer:
        """Return the performer of an action by its name."""
        return self._performers[name]

    def objection(self, action: Action, scope: Scope) -> str:
        """Return why the vehicle cannot perform an action; empty if it can."""
        performer = self._performers.get(action.type)
        if performer is None:
            return f"the vehicle has no action {action.type}"
        if scope not in performer.type.scopes:
            return f"{action.type} is not possible as {scope.value.lower()} action"
        keys = {parameter.key for parameter in performer.type.parameters}
        for parameter in performer.type.parameters:
            if not parameter.optional and parameter.key not in action.parameters:
                return f"{action.type} needs the parameter {parameter.key}"
        for key in action.parameters:
            if key not in keys:
                return f"{action.type} has no parameter {key}"
        return performer.check(action)
