"""Instant actions and their states."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.actions.runner import ActionRunner
from woosh_robot_agent.vda5050.model.errors import ErrorType, VehicleError, warning
from woosh_robot_agent.vda5050.model.factsheet import Scope
from woosh_robot_agent.vda5050.model.order import Action
from woosh_robot_agent.vda5050.model.state import ActionState, ActionStatus

_MAX_STATES = 200
"""Number of instant actions above which those that have ended are forgotten."""
_MAX_ERRORS = 20
"""Maximum number of errors of instant actions; the oldest ones are forgotten."""


class InstantActions:
    """Instant actions since the last order.

    Args:
        registry: the actions of the vehicle.
        runner: performs them.

    Attributes:
        errors: errors of instant actions that the vehicle could not perform.
    """

    def __init__(self, registry: Registry, runner: ActionRunner) -> None:
        self._registry = registry
        self._runner = runner
        self._states: dict[str, ActionState] = {}
        self.errors: deque[VehicleError] = deque(maxlen=_MAX_ERRORS)

    @property
    def states(self) -> tuple[ActionState, ...]:
        """States of the instant actions since the last order."""
        return tuple(self._states.values())

    def receive(self, actions: Sequence[Action]) -> None:
        """Perform instant actions; those that were received before are ignored."""
        for action in actions:
            if action.id in self._states:
                continue
            self._states[action.id] = ActionState(
                action.id, action.type, ActionStatus.WAITING, description=action.description
            )
            objection = self._registry.objection(action, Scope.INSTANT)
            if sum(not state.status.ended for state in self._states.values()) > _MAX_STATES:
                objection = f"more than {_MAX_STATES} instant actions run"
            if objection:
                self.changed(action.id, ActionStatus.FAILED, objection)
                self.errors.append(
                    warning(
                        ErrorType.INSTANT_ACTION,
                        objection,
                        "see the factsheet for the actions of the vehicle",
                        actionId=action.id,
                        actionType=action.type,
                    )
                )
            else:
                self._runner.start(action)
        self._forget_oldest()

    def restore(self, states: Sequence[ActionState], *, again: str) -> None:
        """Take the states from before a restart. Actions that ran have failed.

        Args:
            states: the states.
            again: type of the actions that are performed again, because they do no harm.
        """
        for state in states:
            self._states[state.id] = state
            if state.status.ended:
                continue
            if state.type == again:
                self._runner.start(Action(state.id, state.type, description=state.description))
            else:
                self.changed(state.id, ActionStatus.FAILED, "the connector was restarted")

    def changed(self, action_id: str, status: ActionStatus, result: str) -> bool:
        """Take the new status of an action; return False if it is not an instant action."""
        state = self._states.get(action_id)
        if state is None:
            return False
        self._states[action_id] = replace(state, status=status, result=result)
        return True

    def forget_ended(self) -> None:
        """Forget the actions that have ended: there is a new order."""
        self._states = {key: state for key, state in self._states.items() if not state.status.ended}
        self.errors.clear()

    def _forget_oldest(self) -> None:
        """Forget the oldest actions that have ended, if there are too many."""
        surplus = len(self._states) - _MAX_STATES
        ended = [key for key, state in self._states.items() if state.status.ended]
        for key in ended[: max(0, surplus)]:
            del self._states[key]
