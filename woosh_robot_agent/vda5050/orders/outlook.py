"""The order ahead of the vehicle: the end of the base, and speed limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from woosh_robot_agent.vda5050.messages.order import Edge, Node
from woosh_robot_agent.vda5050.messages.state import Position

_BASE_IS_SHORT = 3.0
"""Length of the rest of the base below which the vehicle asks for more, in metres."""
_BRAKING = 1.5
"""Distance from a slower edge at which the vehicle begins to slow down, in metres."""


def needs_base(nodes: Sequence[Node], position: Position | None) -> bool:
    """Return True if the vehicle needs more of the horizon released.

    It does on the last edge of the base, and if the rest of the base is short.

    Args:
        nodes: nodes still to be reached, the horizon included.
        position: position of the vehicle; None if unknown.
    """
    base = [node for node in nodes if node.released]
    if len(base) == len(nodes):
        return False
    if len(base) <= 1:
        return True
    return position is not None and max(_distances(base, position)) < _BASE_IS_SHORT


def speed_limit(edges: Sequence[Edge], nodes: Sequence[Node], position: Position | None) -> float:
    """Return the speed that the vehicle must not exceed, in m/s; infinite without a limit.

    Args:
        edges: rest of the leg; the vehicle is on the first edge.
        nodes: the node at the end of each of them.
        position: position of the vehicle; None if unknown.
    """
    limits = [edge.max_speed for edge in edges[:1]]
    if position is not None:
        ahead = zip(edges[1:], _distances(nodes, position), strict=False)
        limits += [edge.max_speed for edge, distance in ahead if distance < _BRAKING]
        # the robot may have missed the node before the next edge
        if len(edges) > 1 and _distance_to_line(position, *nodes[:2]) < _BRAKING:
            limits.append(edges[1].max_speed)
    return min((limit for limit in limits if limit is not None), default=math.inf)


def _distance_to_line(position: Position, start: Node, end: Node) -> float:
    """Return the distance of a position from the line between two nodes, in metres."""
    if start.position is None or end.position is None:
        return math.inf
    along_x, along_y = end.position.x - start.position.x, end.position.y - start.position.y
    x, y = position.x - start.position.x, position.y - start.position.y
    length = along_x**2 + along_y**2
    part = min(1.0, max(0.0, (x * along_x + y * along_y) / length)) if length else 0.0
    return math.hypot(x - part * along_x, y - part * along_y)


def _distances(nodes: Sequence[Node], position: Position) -> Iterator[float]:
    """Yield the distance to each node along the nodes before it, in metres."""
    distance, x, y = 0.0, position.x, position.y
    for node in nodes:
        if node.position is not None:
            distance += math.hypot(node.position.x - x, node.position.y - y)
            x, y = node.position.x, node.position.y
        yield distance
