"""Legs: the parts of an order that the robot drives without a stop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from woosh_robot_agent.vda5050.model.order import Action, Edge, Node
from woosh_robot_agent.vda5050.orders.curve import curve_points

_MAX_POSES = 150
"""Maximum number of poses in a task of the robot; a chassis may refuse longer paths."""


@dataclass(frozen=True)
class Leg:
    """A part of an order that the robot drives without a stop.

    Attributes:
        edges: edges in the order of traversal.
        nodes: the node at the end of each edge.
    """

    edges: tuple[Edge, ...]
    nodes: tuple[Node, ...]

    @property
    def goal(self) -> Node:
        """The last node."""
        return self.nodes[-1]


def next_leg(edges: Sequence[Edge], nodes: Sequence[Node]) -> Leg | None:
    """Return the next leg of an order; None if the next edge is not released.

    Args:
        edges: edges still to be driven.
        nodes: the node at the end of each of them.
    """
    base = [(edge, node) for edge, node in zip(edges, nodes, strict=True) if edge.released]
    if not base:
        return None
    poses = _poses(base[0][0])
    length = 1
    for (before, node), (edge, following) in pairwise(base):
        poses += _poses(edge)
        if poses > _MAX_POSES or stops_at(node) or stops(edge.actions):
            break
        if changes_way(before, node, edge, following):
            break
        length += 1
    chosen = base[:length]
    return Leg(tuple(edge for edge, _ in chosen), tuple(node for _, node in chosen))


def _poses(edge: Edge) -> int:
    """Return the number of poses in the task for an edge."""
    return 1 if edge.trajectory is None else len(curve_points(edge.trajectory))


def stops_at(node: Node) -> bool:
    """Return True if the vehicle must stop on a node: for an action, a heading or a mark."""
    place = node.position
    turns = place is not None and place.theta is not None and abs(place.deviation_theta) < math.pi
    return turns or bool(node.mark) or stops(node.actions)


def stops(actions: Sequence[Action]) -> bool:
    """Return True if the vehicle must not drive while some of these actions run."""
    return any(action.blocking.stops for action in actions)


def changes_way(before: Edge, node: Node, edge: Edge, following: Node) -> bool:
    """Return True if the edge after a node needs a task of its own.

    Args:
        before: the edge to the node.
        node: the node.
        edge: the edge after the node.
        following: the node at its end.
    """
    if following.mark or (before.trajectory is None) != (edge.trajectory is None):
        return True
    here, there = node.position, following.position
    return here is None or there is None or here.map_id != there.map_id
