"""Actions that request a message or cancel the order."""

from __future__ import annotations

from woosh_robot_agent.vda5050.actions.performer import Context
from woosh_robot_agent.vda5050.model.factsheet import ActionType, Scope
from woosh_robot_agent.vda5050.model.order import Action

_INSTANT = frozenset({Scope.INSTANT})


class StateRequest:
    """Publishes the state."""

    type = ActionType("stateRequest", _INSTANT, "publish the state")

    def __init__(self, context: Context) -> None:
        self._context = context

    def check(self, action: Action) -> str:
        return ""

    async def perform(self, action: Action) -> str:
        self._context.vehicle.publish_state()
        return ""


class FactsheetRequest:
    """Publishes the factsheet."""

    type = ActionType("factsheetRequest", _INSTANT, "publish the factsheet")

    def __init__(self, context: Context) -> None:
        self._context = context

    def check(self, action: Action) -> str:
        return ""

    async def perform(self, action: Action) -> str:
        self._context.vehicle.publish_factsheet()
        return ""


class CancelOrder:
    """Cancels the order."""

    type = ActionType("cancelOrder", _INSTANT, "stop, and cancel the order")

    def __init__(self, context: Context) -> None:
        self._context = context

    def check(self, action: Action) -> str:
        return ""

    async def perform(self, action: Action) -> str:
        await self._context.vehicle.cancel_order(action.id)
        return ""
