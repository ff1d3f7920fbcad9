"""Instant actions and their states."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

from woosh_robot_agent.vda5050.actions.errors import Objection
from woosh_robot_agent.vda5050.actions.performer import VehicleControls
from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.actions.runner import ActionRunner
from woosh_robot_agent.vda5050.model.errors import ErrorType, VehicleError, warning
from woosh_robot_agent.vda5050.model.factsheet import ActionType, Scope
from woosh_robot_agent.vda5050.model.order import Action, BlockingType
from woosh_robot_agent.vda5050.model.state import ActionState, ActionStatus

_MAX_STATES = 200
"""Maximum number of instant actions in the state. Beyond it, ended ones are forgotten, and new ones
fail if none has ended."""
_MAX_ERRORS = 20
"""Maximum number of errors of actions; the oldest ones are forgotten."""


class InstantActions:
    """Instant actions since the last order.

    Args:
        registry: the actions of the vehicle.
        runner: performs them.
        vehicle: is held while an action forbids driving.

    Attributes:
        errors: errors of actions that failed.
    """

    def __init__(self, registry: Registry, runner: ActionRunner, vehicle: VehicleControls) -> None:
        self._registry = registry
        self._runner = runner
        self._vehicle = vehicle
        self._states: dict[str, ActionState] = {}
        self.errors: deque[VehicleError] = deque(maxlen=_MAX_ERRORS)

    @property
    def states(self) -> tuple[ActionState, ...]:
        """States of the instant actions since the last order."""
        return tuple(self._states.values())

    def receive(self, actions: Sequence[Action]) -> None:
        """Perform instant actions; those with a known id are ignored."""
        for action in actions:
            if action.id in self._states:
                continue
            self._states[action.id] = ActionState(
                action.id,
                action.type,
                ActionStatus.WAITING,
                description=action.description,
                instant=True,
            )
            objection = self._registry.objection(action, Scope.INSTANT)
            if sum(not state.status.ended for state in self._states.values()) > _MAX_STATES:
                objection = Objection(f"more than {_MAX_STATES} instant actions run")
            if objection is not None:
                self.errors.append(
                    warning(
                        ErrorType.INSTANT_ACTION,
                        objection.reason,
                        "see the factsheet for the actions of the vehicle",
                        actionId=action.id,
                        actionType=action.type,
                        **objection.references,
                    )
                )
                self.changed(action.id, ActionStatus.FAILED, objection.reason)
            else:
                self._start(action, self._registry.get(action.type).type)
        self._forget_oldest()

    def restore(self, states: Sequence[ActionState], *, again: str) -> None:
        """Restore the states after a restart. Actions that ran have failed.

        Args:
            states: the states.
            again: type of the actions that are performed again; they must be harmless.
        """
        for state in states:
            self._states[state.id] = state
            if state.status.ended:
                continue
            if state.type == again:
                action = Action(state.id, state.type, description=state.description)
                self._runner.start(action, at_once=True)
            else:
                self.changed(state.id, ActionStatus.FAILED, "the connector was restarted")

    def changed(self, action_id: str, status: ActionStatus, result: str) -> bool:
        """Take the new status of an action; return False if it is not an instant action."""
        state = self._states.get(action_id)
        if state is None:
            return False
        self._states[action_id] = replace(state, status=status, result=result)
        if status.ended:
            self._vehicle.release(_hold_of(action_id))
        return True

    def failed(self, action: Action, reason: str, kind: ErrorType) -> None:
        """Store the error of an action that failed, be it an instant action or not."""
        self.errors.append(warning(kind, reason, actionId=action.id, actionType=action.type))

    def forget_ended(self) -> None:
        """Forget the actions that have ended, and all errors."""
        self._states = {key: state for key, state in self._states.items() if not state.status.ended}
        self.errors.clear()

    def _start(self, action: Action, kind: ActionType) -> None:
        if kind.scopes == {Scope.INSTANT}:
            # it controls the vehicle, so it waits for nothing, whatever its blockingType
            self._runner.start(action, at_once=True)
            return
        if action.blocking not in kind.blocking:
            action = replace(action, blocking=BlockingType.HARD)
        if action.blocking.stops:
            self._vehicle.hold(_hold_of(action.id))
        self._runner.start(action)

    def _forget_oldest(self) -> None:
        """Forget the oldest actions that have ended, if there are too many."""
        surplus = len(self._states) - _MAX_STATES
        ended = [key for key, state in self._states.items() if state.status.ended]
        for key in ended[: max(0, surplus)]:
            del self._states[key]


def _hold_of(action_id: str) -> str:
    return f"action {action_id}"
