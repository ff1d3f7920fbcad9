"""All actions of the vehicle."""

from __future__ import annotations

from collections.abc import Callable

from woosh_robot_agent.vda5050.actions.custom import (
    LiftTo,
    Rotate,
    Speak,
    Step,
    SwitchFootprint,
    parameter_objection,
)
from woosh_robot_agent.vda5050.actions.map_actions import DeleteMap, DownloadMap, EnableMap
from woosh_robot_agent.vda5050.actions.performer import Context, Performer
from woosh_robot_agent.vda5050.actions.robot_calls import Objection
from woosh_robot_agent.vda5050.actions.standard import (
    CancelOrder,
    ClearInstantActions,
    Drop,
    FactsheetRequest,
    InitializePosition,
    InitPosition,
    Pick,
    StartCharging,
    StartPause,
    StateRequest,
    StopCharging,
    StopPause,
)
from woosh_robot_agent.vda5050.messages.factsheet import ActionType, Scope
from woosh_robot_agent.vda5050.messages.order import Action

_PERFORMERS: tuple[Callable[[Context], Performer], ...] = (
    StartPause,
    StopPause,
    CancelOrder,
    FactsheetRequest,
    StateRequest,
    StartCharging,
    StopCharging,
    Pick,
    Drop,
    EnableMap,
    DownloadMap,
    DeleteMap,
    LiftTo,
    Step,
    Rotate,
    SwitchFootprint,
    Speak,
)
"""Actions of all versions of the standard."""
_OF_VERSION: dict[str, tuple[Callable[[Context], Performer], ...]] = {
    "2": (InitPosition,),
    "3": (InitializePosition, ClearInstantActions),
}
"""Further actions, by the first number of the version."""


class Registry:
    """The actions of a vehicle, by name.

    Args:
        context: objects that the actions share.
        version: version of the standard, e.g. `2.1.0`.
        further: actions of this vehicle alone.
    """

    def __init__(
        self,
        context: Context,
        version: str,
        further: tuple[Callable[[Context], Performer], ...] = (),
    ) -> None:
        makers = (*_PERFORMERS, *_OF_VERSION[version.partition(".")[0]], *further)
        performers = [make(context) for make in makers]
        self._performers = {each.type.name: each for each in performers}

    @property
    def types(self) -> tuple[ActionType, ...]:
        """All actions, for the factsheet."""
        return tuple(each.type for each in self._performers.values())

    def get(self, name: str) -> Performer:
        """Return the performer of an action by its name."""
        return self._performers[name]

    def may_repeat(self, name: str) -> bool:
        """Return True if an instant action may have the id of one that has ended."""
        performer = self._performers.get(name)
        return performer is not None and performer.type.repeatable

    def objection(self, action: Action, scope: Scope) -> Objection | None:
        """Return why the vehicle cannot perform an action; None if it can."""
        performer = self._performers.get(action.type)
        if performer is None:
            return Objection(f"the vehicle has no action {action.type}")
        kind = performer.type
        if scope not in kind.scopes:
            places = " or ".join(sorted(each.value.lower() for each in kind.scopes))
            return Objection(
                f"{action.type} is not possible as {scope.value.lower()} action, only as {places} "
                "action"
            )
        if scope is not Scope.INSTANT and action.blocking not in kind.blocking:
            permitted = " or ".join(sorted(each.value for each in kind.blocking))
            return Objection(
                f"{action.type} needs blockingType {permitted}, not {action.blocking.value}"
            )
        return parameter_objection(kind, action.parameters) or performer.check(action)
