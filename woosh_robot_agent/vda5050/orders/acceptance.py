"""Acceptance of an order, as a new one or as an update."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

from woosh_robot_agent.vda5050.model.errors import ErrorType, rejection
from woosh_robot_agent.vda5050.model.order import Node, Order
from woosh_robot_agent.vda5050.orders.structure import check_structure


class Verdict(Enum):
    """Treatment of an order that is not rejected."""

    NEW = "new"
    """Replace the current order by it."""
    UPDATE = "update"
    """Append it to the current order."""
    KNOWN = "known"
    """Ignore it: the vehicle has it already."""


def judge(
    order: Order,
    current: Order | None,
    *,
    busy: bool,
    cancelled: bool,
    decision_point: Node | None,
) -> Verdict:
    """Decide what to do with an order. A new one also needs `check_start`.

    Args:
        order: the order that arrived.
        current: the last order or update that the vehicle took; None if there was none.
        busy: True if the vehicle executes the current order, or waits for an update of it.
        cancelled: True if the current order was cancelled.
        decision_point: last node of the current base, or the last one that was reached if there is
            no base left.

    Raises:
        RejectedError: the vehicle cannot take the order.
    """
    check_structure(order)
    if current is None or order.id != current.id:
        if busy:
            raise rejection(
                ErrorType.OTHER_ORDER_ACTIVE,
                order,
                "the vehicle still executes another order, or waits for its update",
                "wait for its end, or cancel it with cancelOrder",
            )
        return Verdict.NEW
    if order.update_id < current.update_id:
        raise rejection(
            ErrorType.OUTDATED_UPDATE,
            order,
            f"the vehicle has orderUpdateId {current.update_id} already",
            "send updates with increasing orderUpdateId",
        )
    is_restored = not current.nodes  # its content did not survive a restart
    if order == current or (is_restored and order.update_id == current.update_id):
        return Verdict.KNOWN
    if order.update_id == current.update_id:
        raise rejection(
            ErrorType.CHANGED_UPDATE,
            order,
            f"the vehicle has another content of orderUpdateId {current.update_id}",
            "send a changed order with a larger orderUpdateId",
        )
    if cancelled:
        raise rejection(
            ErrorType.UPDATE_AFTER_CANCEL,
            order,
            "the order was cancelled",
            "send a new order with another orderId",
        )
    first = order.nodes[0]
    if decision_point is None or (first.id, first.sequence_id) != (
        decision_point.id,
        decision_point.sequence_id,
    ):
        raise rejection(
            ErrorType.ORDER_UPDATE,
            order,
            "the update does not begin with the last node of the base",
            "begin the update with the last released node of the order"
            if decision_point is None
            else f"begin the update with node {decision_point.id}, "
            f"sequenceId {decision_point.sequence_id}",
            nodeId=first.id,
        )
    return Verdict.UPDATE


def check_start(order: Order, in_reach: Callable[[Node], bool]) -> None:
    """Check that a new order begins where the vehicle stands.

    Args:
        order: the order that arrived.
        in_reach: returns True if the vehicle stands on a node or within its permitted deviation.

    Raises:
        RejectedError: it begins elsewhere.
    """
    if not in_reach(order.nodes[0]):
        raise rejection(
            ErrorType.NO_ROUTE,
            order,
            "the vehicle is not within the permitted deviation from the first node",
            "start the order where the vehicle stands, or permit a larger deviation",
            nodeId=order.nodes[0].id,
        )
