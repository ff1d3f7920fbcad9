"""Instant actions and their states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.actions.runner import ActionRunner
from woosh_robot_agent.vda5050.model.errors import ErrorType, VehicleError, warning
from woosh_robot_agent.vda5050.model.factsheet import Scope
from woosh_robot_agent.vda5050.model.order import Action
from woosh_robot_agent.vda5050.model.state import ActionState, ActionStatus


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
        self.errors: list[VehicleError] = []

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
                action.id,
                action.type,
                ActionStatus.WAITING,
                description=action.description,
                instant=True,
            )
            objection = self._registry.objection(action, Scope.INSTANT)
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
