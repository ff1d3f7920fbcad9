"""Actions that request a message, cancel the order or clear a list."""

from __future__ import annotations

from woosh_robot_agent.vda5050.actions.performer import PlainPerformer, Report
from woosh_robot_agent.vda5050.model.factsheet import ActionType, ParameterType, Scope
from woosh_robot_agent.vda5050.model.order import Action

_INSTANT = frozenset({Scope.INSTANT})


class StateRequest(PlainPerformer):
    """Publishes the state."""

    type = ActionType("stateRequest", _INSTANT, "publish the state", repeatable=True)

    async def perform(self, action: Action, report: Report) -> str:
        self._context.vehicle.publish_state()
        return ""


class FactsheetRequest(PlainPerformer):
    """Publishes the factsheet."""

    type = ActionType("factsheetRequest", _INSTANT, "publish the factsheet", repeatable=True)

    async def perform(self, action: Action, report: Report) -> str:
        self._context.vehicle.publish_factsheet()
        return ""


class CancelOrder(PlainPerformer):
    """Cancels the order."""

    type = ActionType(
        "cancelOrder",
        _INSTANT,
        "stop, and cancel the order",
        (ParameterType("orderId", "STRING", "order to cancel; any order if missing", True),),
        repeatable=True,
    )

    async def perform(self, action: Action, report: Report) -> str:
        await self._context.vehicle.cancel_order(action.parameters.get("orderId", ""))
        return ""


class ClearInstantActions(PlainPerformer):
    """Forgets the instant actions that have ended."""

    type = ActionType(
        "clearInstantActions",
        frozenset({Scope.INSTANT, Scope.NODE}),
        "remove the instant actions that have ended from the state",
        repeatable=True,
    )

    async def perform(self, action: Action, report: Report) -> str:
        self._context.vehicle.clear_instant_actions()
        return ""
