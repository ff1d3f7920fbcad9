"""The legs of an order, which the robot drives one by one, with curves and commands."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

from woosh_robot_agent.vda5050.messages.order import (
    MAX_CONTROL_POINTS,
    MAX_DEGREE,
    Action,
    Edge,
    Node,
    Trajectory,
)

_SPACING = 0.25
"""Usual distance between two points along a curve, in metres."""
_MAX_POINTS = 100
"""Approximate maximum number of points along a curve; on a longer one they are farther apart."""
_SAMPLES = 8
"""Number of points in each span of the knots by which the length of the curve is estimated."""

Point = tuple[float, float]
"""Position in the map frame, in metres."""


def curve_defect(trajectory: Trajectory) -> str:
    """Return the defect of a trajectory; empty if it has none."""
    degree, knots, points = trajectory.degree, trajectory.knots, trajectory.points
    numbers = (*knots, *(value for point in points for value in (point.x, point.y, point.weight)))
    if not all(map(math.isfinite, (degree, *numbers))):
        return "a number is not finite"
    if degree != int(degree) or degree < 1:
        return f"its degree is not a positive integer: {degree}"
    if degree > MAX_DEGREE:
        return f"its degree is above {MAX_DEGREE}: {degree:g}"
    if len(points) > MAX_CONTROL_POINTS:
        return f"it has more than {MAX_CONTROL_POINTS} control points: {len(points)}"
    if len(points) <= degree:
        return f"degree {degree} needs at least {int(degree) + 1} control points: {len(points)}"
    if len(knots) != len(points) + degree + 1:
        return (
            f"{len(points)} control points of degree {int(degree)} need "
            f"{len(points) + int(degree) + 1} knots: {len(knots)}"
        )
    if any(after < before for before, after in pairwise(knots)):
        return "its knots decrease"
    if knots[int(degree)] == knots[len(points)]:
        return "its knots are all equal"
    if any(point.weight <= 0 for point in points):
        return "a weight is not positive"
    return ""


@functools.lru_cache(maxsize=256)
def curve_points(trajectory: Trajectory) -> tuple[Point, ...]:
    """Return points along a trajectory without a defect, its start and end included."""
    degree, knots = int(trajectory.degree), trajectory.knots
    spans = [
        span for span in range(degree, len(trajectory.points)) if knots[span] < knots[span + 1]
    ]
    lengths = [_length(_points_of_span(trajectory, span, _SAMPLES)) for span in spans]
    spacing = max(_SPACING, sum(lengths) / _MAX_POINTS)
    points = [_point(trajectory, spans[0], knots[spans[0]])]
    for span, length in zip(spans, lengths, strict=True):
        # a straight line needs only its end
        count = 1 if degree == 1 else max(degree, math.ceil(length / spacing))
        points += _points_of_span(trajectory, span, count)[1:]
    return tuple(points)


def _length(points: list[Point]) -> float:
    return sum(math.dist(before, after) for before, after in pairwise(points))


def _points_of_span(trajectory: Trajectory, span: int, count: int) -> list[Point]:
    """Return the start of a span of the knots and `count` points after it."""
    start, end = trajectory.knots[span : span + 2]
    steps = [start + (end - start) * step / count for step in range(count)]
    return [_point(trajectory, span, at) for at in (*steps, end)]


def _point(trajectory: Trajectory, span: int, at: float) -> Point:
    """Return the point of a curve at a parameter in a span of its knots, by de Boor's algorithm."""
    degree, knots = int(trajectory.degree), trajectory.knots
    control = trajectory.points[span - degree : span + 1]
    # in homogeneous coordinates a rational curve is an ordinary one
    values = [(each.x * each.weight, each.y * each.weight, each.weight) for each in control]
    for level in range(1, degree + 1):
        for index in range(degree, level - 1, -1):
            low = knots[span - degree + index]
            width = knots[index + 1 + span - level] - low
            part = (at - low) / width if width else 0.0
            values[index] = tuple(  # type: ignore[assignment]
                (1 - part) * before + part * after
                for before, after in zip(values[index - 1], values[index], strict=True)
            )
    x, y, weight = values[degree]
    return x / weight, y / weight


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


@dataclass(frozen=True)
class Drive:
    """Drive a leg, and report its end with `OrderMachine.drive_ended`."""

    leg: Leg


@dataclass(frozen=True)
class CancelDrive:
    """Cancel the drive, and report its end with `OrderMachine.drive_ended`."""


@dataclass(frozen=True)
class PauseDrive:
    """Pause the drive."""


@dataclass(frozen=True)
class ResumeDrive:
    """Resume the paused drive."""


@dataclass(frozen=True)
class Perform:
    """Perform an action, and report its progress with `OrderMachine.action_changed`."""

    action: Action


@dataclass(frozen=True)
class EndAction:
    """End an action that runs: the vehicle has left its edge, or the order was cancelled."""

    action: Action


Command: TypeAlias = Drive | CancelDrive | PauseDrive | ResumeDrive | Perform | EndAction
"""Any command of the state machine."""
