"""Legs: the parts of an order that the robot drives without a stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from woosh_robot_agent.vda5050.model.order import Action, Edge, Node


@dataclass(frozen=True)
class Leg:
    """A part of an order that the robot drives without a stop.

    Attributes:
        edges: edges in the sequence of traversal.
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
    length = 1
    for (_, node), (edge, following) in pairwise(base):
        if stops_at(node) or stops(edge.actions) or changes_way(node, edge, following):
            break
        length += 1
    chosen = base[:length]
    return Leg(tuple(edge for edge, _ in chosen), tuple(node for _, node in chosen))


def stops_at(node: Node) -> bool:
    """Return True if the vehicle must stop on a node, for an action or to turn to a heading."""
    turns = node.position is not None and node.position.theta is not None
    return turns or bool(node.mark) or stops(node.actions)


def stops(actions: Sequence[Action]) -> bool:
    """Return True if the vehicle must not drive while some of these actions run."""
    return any(action.blocking.stops for action in actions)


def changes_way(node: Node, edge: Edge, following: Node) -> bool:
    """Return True if the way after a node needs a drive of its own."""
    if following.mark or edge.trajectory is not None:
        return True
    here, there = node.position, following.position
    return here is None or there is None or here.map_id != there.map_id
