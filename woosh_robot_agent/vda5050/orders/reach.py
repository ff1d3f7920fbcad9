"""Traversal of nodes, by the permitted deviation from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from woosh_robot_agent.vda5050.model.order import NodePosition
from woosh_robot_agent.vda5050.model.state import Position


@dataclass(frozen=True)
class Tolerance:
    """Minimum tolerance at a node; a smaller permitted deviation is raised to it.

    Attributes:
        xy: distance, in metres.
        theta: angle, in radians.
    """

    xy: float = 0.25
    theta: float = 0.1


def is_reached(
    node: NodePosition, before: Position | None, now: Position, tolerance: Tolerance
) -> bool:
    """Return True if the vehicle has passed a node on its way from one position to the next.

    Args:
        node: position of the node.
        before: last position of the vehicle; None if there was none.
        now: position of the vehicle.
        tolerance: minimum tolerance.
    """
    if node.map_id != now.map_id:
        return False
    if not _is_within(node, now if before is None else before, now, tolerance.xy):
        return False
    if node.theta is None:
        return True
    error = math.remainder(node.theta - now.theta, math.tau)
    return abs(error) <= max(abs(node.deviation_theta), tolerance.theta)


def _is_within(node: NodePosition, before: Position, now: Position, tolerance: float) -> bool:
    """Return True if a straight way leads through the permitted deviation from a node."""
    if node.ellipse is None:
        return _distance_to_way(node, before, now) <= max(node.deviation_xy, tolerance)
    a, b = max(node.ellipse.a, tolerance), max(node.ellipse.b, tolerance)
    cos, sin = math.cos(node.ellipse.theta), math.sin(node.ellipse.theta)

    def scaled(place: Position) -> Position:
        """Return the place in axes in which the ellipse is a circle of radius 1 at the origin."""
        x, y = place.x - node.x, place.y - node.y
        return replace(place, x=(x * cos + y * sin) / a, y=(y * cos - x * sin) / b)

    origin = replace(node, x=0.0, y=0.0)
    return _distance_to_way(origin, scaled(before), scaled(now)) <= 1.0


def _distance_to_way(node: NodePosition, before: Position, now: Position) -> float:
    """Return the distance of a node from the straight way between two positions, in metres."""
    along_x, along_y = now.x - before.x, now.y - before.y
    length = along_x**2 + along_y**2
    part = 0.0
    if length and before.map_id == now.map_id:
        part = ((node.x - before.x) * along_x + (node.y - before.y) * along_y) / length
        part = min(1.0, max(0.0, part))
    elif length:
        part = 1.0
    return math.hypot(node.x - before.x - part * along_x, node.y - before.y - part * along_y)
