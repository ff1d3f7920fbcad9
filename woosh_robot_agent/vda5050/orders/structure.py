"""Check of the structure of an order: its nodes and edges form one path."""

from __future__ import annotations

from collections.abc import Collection
from itertools import pairwise

from woosh_robot_agent.vda5050.model.errors import ErrorType, RejectedError, rejection
from woosh_robot_agent.vda5050.model.order import Edge, Node, Order


def check_structure(order: Order) -> None:
    """Check that the nodes and edges of an order form one path, the base before the horizon.

    Raises:
        RejectedError: they do not.
    """
    if not order.nodes:
        raise _malformed(order, "the order has no node")
    if len(order.edges) != len(order.nodes) - 1:
        raise _malformed(
            order,
            f"the order has {len(order.nodes)} nodes and {len(order.edges)} edges; it needs one "
            "edge less than nodes",
        )
    if not order.nodes[0].released:
        raise _malformed(order, "the first node is not released", nodeId=order.nodes[0].id)
    path: list[Node | Edge] = [order.nodes[0]]
    for edge, node in zip(order.edges, order.nodes[1:], strict=True):
        path += [edge, node]
        if (edge.start_node_id, edge.end_node_id) != (path[-3].id, node.id):
            raise _malformed(
                order, "the edge does not connect the nodes before and after it", edgeId=edge.id
            )
        if edge.released and not node.released:
            raise _malformed(order, "the edge is released, but its end node is not", edgeId=edge.id)
    for before, after in pairwise(path):
        key = "nodeId" if isinstance(after, Node) else "edgeId"
        if after.sequence_id != before.sequence_id + 1:
            raise _malformed(
                order,
                f"sequenceId {after.sequence_id} does not follow {before.sequence_id}",
                **{key: after.id},
            )
        if after.released and not before.released:
            raise _malformed(order, "it is released, but its predecessor is not", **{key: after.id})
    check_action_ids(order, ())


def check_action_ids(order: Order, used: Collection[str]) -> None:
    """Check that each action of an order has an id of its own.

    Args:
        order: the order; in an update, the actions of the first node are known already.
        used: ids of the actions of the current order; empty for a new order.

    Raises:
        RejectedError: two actions have the same id.
    """
    seen = set(used)
    known = order.nodes[0] if used else None
    parts: tuple[Node | Edge, ...] = (*order.nodes, *order.edges)
    for part in parts:
        for action in part.actions if part is not known else ():
            if action.id in seen:
                raise _malformed(order, "two actions have the same id", actionId=action.id)
            seen.add(action.id)


def check_instant_ids(order: Order, taken: Collection[str]) -> None:
    """Check that no action of an order has the id of an instant action.

    Raises:
        RejectedError: one has.
    """
    parts: tuple[Node | Edge, ...] = (*order.nodes, *order.edges)
    for action in (each for part in parts for each in part.actions):
        if action.id in taken:
            raise _malformed(order, "an instant action has this id", actionId=action.id)


def _malformed(order: Order, reason: str, **references: object) -> RejectedError:
    return rejection(
        ErrorType.VALIDATION, order, reason, "correct the order and send it again", **references
    )
