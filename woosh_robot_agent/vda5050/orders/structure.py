"""Check that an order or update fits the current order, and find the marks at its nodes."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from enum import Enum
from itertools import pairwise

from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.messages.order import Edge, Node, NodePosition, Order
from woosh_robot_agent.vda5050.messages.state import (
    ErrorType,
    Position,
    RejectedError,
    rejection,
)
from woosh_robot_agent.vda5050.orders.legs import need_standstill
from woosh_robot_agent.vda5050.orders.reach import is_reached

_NO_ID = Sentence("orderId is empty")
_NO_NODE = Sentence("the order has no node")
_EDGES = Sentence(
    "the order has {nodes} nodes and {edges} edges; it needs one edge less than nodes"
)
_FIRST_NODE = Sentence("the first node is not released")
_APART = Sentence("the edge does not connect the nodes before and after it")
_END_NODE = Sentence("the edge is released, but its end node is not")
_SEQUENCE = Sentence("sequenceId {id} does not follow {before}")
_PREDECESSOR = Sentence("it is released, but its predecessor is not")
_SAME_ID = Sentence("two actions have the same id")
_INSTANT_ID = Sentence("an instant action has this id")
_OTHER_ORDER = Sentence("the vehicle still executes another order, or waits for its update")
_OUTDATED = Sentence("the vehicle has orderUpdateId {id} already")
_CHANGED = Sentence("the vehicle has another content of orderUpdateId {id}")
_CANCELLED = Sentence("the order was cancelled")
_NO_UPDATE = Sentence("the update does not begin with the last node of the base")
_NEW_ACTION = Sentence("the last node of the base does not have this action")
_ELSEWHERE = Sentence("the vehicle is not within the permitted deviation from the first node")


def check_structure(order: Order) -> None:
    """Check that the nodes and edges of an order form one path, the base before the horizon.

    Check also that the order and each of its actions have an id of their own.

    Raises:
        RejectedError: the order is malformed.
    """
    if not order.id:  # it would stand for no order
        raise _malformed(order, _NO_ID())
    if not order.nodes:
        raise _malformed(order, _NO_NODE())
    if len(order.edges) != len(order.nodes) - 1:
        raise _malformed(order, _EDGES(nodes=len(order.nodes), edges=len(order.edges)))
    if not order.nodes[0].released:
        raise _malformed(order, _FIRST_NODE(), nodeId=order.nodes[0].id)
    path: list[Node | Edge] = [order.nodes[0]]
    for (start, end), edge in zip(pairwise(order.nodes), order.edges, strict=True):
        path += [edge, end]
        if (edge.start_node_id, edge.end_node_id) != (start.id, end.id):
            raise _malformed(order, _APART(), edgeId=edge.id)
        if edge.released and not end.released:
            raise _malformed(order, _END_NODE(), edgeId=edge.id)
    for before, after in pairwise(path):
        key = "nodeId" if isinstance(after, Node) else "edgeId"
        if after.sequence_id != before.sequence_id + 1:
            raise _malformed(
                order,
                _SEQUENCE(id=after.sequence_id, before=before.sequence_id),
                **{key: after.id},
            )
        if after.released and not before.released:
            raise _malformed(order, _PREDECESSOR(), **{key: after.id})
    check_action_ids(order, ())


def check_action_ids(order: Order, used: Collection[str]) -> None:
    """Check that each action of an order has an id of its own.

    Args:
        order: the order; in an update, the actions of the first node are known already.
        used: ids of the actions that the current order keeps; empty for a new order.

    Raises:
        RejectedError: two actions have the same id.
    """
    seen = set(used)
    skipped = order.nodes[0] if used else None
    for part in order.parts:
        for action in part.actions if part is not skipped else ():
            if action.id in seen:
                raise _malformed(order, _SAME_ID(), actionId=action.id)
            seen.add(action.id)


def check_instant_ids(order: Order, taken: Collection[str]) -> None:
    """Check that no action of an order has the id of an instant action.

    Raises:
        RejectedError: an action has such an id.
    """
    for action in (each for part in order.parts for each in part.actions):
        if action.id in taken:
            raise _malformed(order, _INSTANT_ID(), actionId=action.id)


def _malformed(order: Order, reason: str, **references: object) -> RejectedError:
    return rejection(
        ErrorType.VALIDATION, order, reason, "correct the order and send it again", **references
    )


class OrderKind(Enum):
    """Kind of an order that is not rejected."""

    NEW = "new"
    """It replaces the current order."""
    UPDATE = "update"
    """It is appended to the current order."""
    KNOWN = "known"
    """The vehicle has it already, and ignores it."""


def classify(
    order: Order,
    current: Order | None,
    *,
    busy: bool,
    cancelled: bool,
    is_3: bool,
    decision_point: Node | None,
) -> OrderKind:
    """Check an order, and return its kind. A new order also needs `check_start`.

    Args:
        current: the last order or update that the vehicle took; None before the first order.
        busy: True if the vehicle executes the current order, or waits for an update of it.
        is_3: False to ignore what has the orderUpdateId of the current order, whatever it contains
            (version 2.1).
        decision_point: last node of the current base, or the last reached node if no base is left.

    Raises:
        RejectedError: the vehicle cannot take the order.
    """
    check_structure(order)
    if current is None or order.id != current.id:
        if busy:
            raise rejection(
                ErrorType.OTHER_ORDER_ACTIVE,
                order,
                _OTHER_ORDER(),
                "wait for its end, or cancel it with cancelOrder",
            )
        return OrderKind.NEW
    if order.update_id < current.update_id:
        raise rejection(
            ErrorType.OUTDATED_UPDATE,
            order,
            _OUTDATED(id=current.update_id),
            "send updates with increasing orderUpdateId",
        )
    is_repeated = order.update_id == current.update_id
    if is_repeated and not is_3:
        return OrderKind.KNOWN
    if cancelled:
        raise rejection(
            ErrorType.UPDATE_AFTER_CANCEL,
            order,
            _CANCELLED(),
            "send a new order with another orderId",
        )
    is_restored = not current.nodes  # only the ids of an order survive a restart
    if is_repeated and (is_restored or order == current):
        return OrderKind.KNOWN
    if is_repeated:
        raise rejection(
            ErrorType.CHANGED_UPDATE,
            order,
            _CHANGED(id=current.update_id),
            "send a changed order with a larger orderUpdateId",
        )
    first = order.nodes[0]
    if decision_point is None or (first.id, first.sequence_id) != (
        decision_point.id,
        decision_point.sequence_id,
    ):
        raise rejection(
            ErrorType.ORDER_UPDATE,
            order,
            _NO_UPDATE(),
            "begin the update with the last released node of the order"
            if decision_point is None
            else f"begin the update with node {decision_point.id}, "
            f"sequenceId {decision_point.sequence_id}",
            nodeId=first.id,
        )
    return OrderKind.UPDATE


def check_first_actions(order: Order, is_known: Callable[[str], bool]) -> None:
    """Check that an update adds no action to its first node, the last one of the base.

    Raises:
        RejectedError: `is_known` returns False for the id of an action of the node.
    """
    for action in order.nodes[0].actions:
        if not is_known(action.id):
            raise rejection(
                ErrorType.ORDER_UPDATE,
                order,
                _NEW_ACTION(),
                "leave the first node as it was, and add a node with the action at the same place",
                nodeId=order.nodes[0].id,
                actionId=action.id,
            )


def check_start(order: Order, stands_on: Callable[[Node], bool]) -> None:
    """Check that the vehicle stands on the first node of a new order, according to `stands_on`.

    Raises:
        RejectedError: the order begins elsewhere.
    """
    if not stands_on(order.nodes[0]):
        raise rejection(
            ErrorType.NO_ROUTE,
            order,
            _ELSEWHERE(),
            "start the order where the vehicle stands, or permit a larger deviation",
            nodeId=order.nodes[0].id,
        )


FindMark = Callable[[str, str], NodePosition | None]
"""Returns the position of a mark by its number and the id of a map; None if the map has no such
mark."""


def with_marks(order: Order, map_id: str, find: FindMark) -> Order:
    """Return an order with `Node.mark` set at the nodes to which the robot drives by a mark.

    The id of such a node is the number of the mark. The node has no position, and gets that of the
    mark; or it is at the mark, and has an action that forbids driving, e.g. `pick`.

    Args:
        map_id: id of the map for nodes without a position.
    """

    def with_mark(node: Node) -> Node:
        place = node.position
        mark = find(node.id, map_id if place is None else place.map_id)
        if mark is None:
            return node
        if place is None:
            # the robot itself chooses the heading at a mark
            return replace(node, mark=node.id, position=replace(mark, theta=None))
        drives_by_mark = need_standstill(node.actions) and _is_at(place, mark)
        return replace(node, mark=node.id) if drives_by_mark else node

    return replace(order, nodes=tuple(map(with_mark, order.nodes)))


def _is_at(place: NodePosition, mark: NodePosition) -> bool:
    """Return True if a robot at a mark is within the permitted deviation from a node.

    The heading must fit, too, unless the mark has none.
    """
    theta = place.theta if mark.theta is None else mark.theta
    here = Position(mark.x, mark.y, theta or 0.0, place.map_id, initialised=True)
    return is_reached(place, None, here)
