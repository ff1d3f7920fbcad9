"""Check of an order against what the vehicle can do."""

from __future__ import annotations

from collections.abc import Iterable

from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.model.errors import ErrorType, RejectedError, warning
from woosh_robot_agent.vda5050.model.factsheet import Scope
from woosh_robot_agent.vda5050.model.order import Action, Order
from woosh_robot_agent.vda5050.model.state import OperatingMode, RobotStatus


class OrderCheck:
    """Finds the reason why a vehicle cannot perform an order.

    Args:
        order: the order.
        registry: the actions of the vehicle.
    """

    def __init__(self, order: Order, registry: Registry) -> None:
        self._order = order
        self._registry = registry

    def check(self, status: RobotStatus | None) -> None:
        """Check the order.

        Args:
            status: state of the robot; None if unknown.

        Raises:
            RejectedError: the vehicle cannot perform it.
        """
        if status is None or status.mode is not OperatingMode.AUTOMATIC:
            raise self._error(
                "the robot is not in automatic mode",
                "switch the robot to automatic control and task mode",
            )
        for edge in self._order.edges:
            if edge.unsupported:
                raise self._error(
                    f"the robot cannot obey {', '.join(edge.unsupported)} of an edge",
                    "leave it out; the factsheet lists the optional fields that the robot obeys",
                    edgeId=edge.id,
                    field=edge.unsupported[0],
                )
        for node in self._order.nodes:
            if node.position is None and not node.mark:
                raise self._error(
                    f"node {node.id} has no position, and the robot has no mark of that name",
                    "give the node a nodePosition, or use the number of a mark as nodeId",
                    nodeId=node.id,
                )
            self._check_actions(node.actions, Scope.NODE, nodeId=node.id)
        for edge in self._order.edges:
            self._check_actions(edge.actions, Scope.EDGE, edgeId=edge.id)

    def _check_actions(self, actions: Iterable[Action], scope: Scope, **place: str) -> None:
        for action in actions:
            if objection := self._registry.objection(action, scope):
                raise self._error(
                    objection.reason,
                    "see the factsheet for the actions of the vehicle",
                    **place,
                    actionId=action.id,
                    actionType=action.type,
                    **objection.references,
                )

    def _error(self, reason: str, hint: str, **references: object) -> RejectedError:
        order = self._order
        return RejectedError(
            warning(
                ErrorType.ORDER,
                reason,
                hint,
                orderId=order.id,
                orderUpdateId=order.update_id,
                **references,
            )
        )
