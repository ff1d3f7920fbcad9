"""Nodes that are driven to by a mark of the robot."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from woosh_robot_agent.vda5050.model.order import Node, NodePosition, Order
from woosh_robot_agent.vda5050.orders.legs import stops
from woosh_robot_agent.vda5050.orders.reach import Tolerance

FindMark = Callable[[str, str], NodePosition | None]
"""Returns the position of a mark by its number and the id of a map; None if there is none."""


def with_marks(order: Order, map_id: str, find: FindMark) -> Order:
    """Return an order in which each node to drive to by a mark has the number of the mark.

    This applies to a node whose id is the number of a mark if the node has no position, or if it is
    at the position of the mark and has an action that forbids driving. A node without a position
    gets that of the mark.

    Args:
        order: the order.
        map_id: id of the map for nodes without a position.
        find: finds marks.
    """
    return replace(order, nodes=tuple(_with_mark(node, map_id, find) for node in order.nodes))


def _with_mark(node: Node, map_id: str, find: FindMark) -> Node:
    place = node.position
    mark = find(node.id, map_id if place is None else place.map_id)
    if mark is None:
        return node
    if place is None:
        # the robot itself chooses the heading at a mark
        return replace(node, mark=node.id, position=replace(mark, theta=None))
    if stops(node.actions) and _is_at(place, mark):
        return replace(node, mark=node.id)
    return node


def _is_at(place: NodePosition, mark: NodePosition) -> bool:
    """Return True if a robot at a mark is within the permitted deviation from a node."""
    tolerance = Tolerance()
    distance = math.hypot(place.x - mark.x, place.y - mark.y)
    if distance > max(place.deviation_xy, tolerance.xy):
        return False
    if place.theta is None or mark.theta is None:
        return True
    error = math.remainder(place.theta - mark.theta, math.tau)
    return abs(error) <= max(abs(place.deviation_theta), tolerance.theta)
