"""The legs of an order, which the robot drives one by one, and the state machines' commands."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from typing import TypeAlias

from woosh_robot_agent.vda5050.messages.geometry import Point, curve_points, nearest_on_line
from woosh_robot_agent.vda5050.messages.order import Action, Edge, Node
from woosh_robot_agent.vda5050.messages.state import Position

_MAX_POSES = 150
"""Maximum number of poses in a task of the robot; a chassis may refuse longer paths."""


@dataclass(frozen=True)
class Leg:
    """A part of an order that the robot drives without a stop.

    Attributes:
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
        nodes: the node at the end of each edge.
    """
    base = [(edge, node) for edge, node in zip(edges, nodes, strict=True) if edge.released]
    if not base:
        return None
    poses = _pose_count(base[0][0])
    length = 1
    for (before, node), (edge, following) in pairwise(base):
        poses += _pose_count(edge)
        if poses > _MAX_POSES or _must_stop_at(node) or need_standstill(edge.actions):
            break
        if _needs_own_task(before, node, edge, following):
            break
        length += 1
    chosen = base[:length]
    return Leg(tuple(edge for edge, _ in chosen), tuple(node for _, node in chosen))


def _pose_count(edge: Edge) -> int:
    """Return the number of poses for an edge in a task of the robot."""
    return 1 if edge.trajectory is None else len(curve_points(edge.trajectory))


def _must_stop_at(node: Node) -> bool:
    """Return True if the vehicle must stop on a node: for an action, a heading or a mark."""
    place = node.position
    turns = place is not None and place.theta is not None and abs(place.deviation_theta) < math.pi
    return turns or bool(node.mark) or need_standstill(node.actions)


def need_standstill(actions: Sequence[Action]) -> bool:
    """Return True if the vehicle must not drive while some of these actions run."""
    return any(action.blocking.forbids_driving for action in actions)


def _needs_own_task(before: Edge, node: Node, edge: Edge, following: Node) -> bool:
    """Return True if one task cannot drive both along `before` to `node` and `edge` to `following`.

    One task of the robot drives to a mark, along trajectories, or through nodes of one map.
    """
    if following.mark or (before.trajectory is None) != (edge.trajectory is None):
        return True
    here, there = node.position, following.position
    return here is None or there is None or here.map_id != there.map_id


_SHORT_BASE = 3.0
"""Length of the rest of the base below which the vehicle asks for more, in metres."""
_BRAKING_DISTANCE = 1.5
"""Distance from a slower edge at which the vehicle begins to slow down, in metres."""


def needs_base(nodes: Sequence[Node], position: Position | None) -> bool:
    """Return True if the vehicle needs more of the horizon released.

    This is so on the last edge of the base, and if the rest of the base is short.

    Args:
        nodes: nodes still to be reached, the horizon included.
        position: position of the vehicle; None if unknown.
    """
    base = [node for node in nodes if node.released]
    if len(base) == len(nodes):
        return False
    if len(base) <= 1:
        return True
    return position is not None and max(_distances(base, position)) < _SHORT_BASE


def speed_limit(edges: Sequence[Edge], nodes: Sequence[Node], position: Position | None) -> float:
    """Return the speed that the vehicle must not exceed, in m/s; infinite without a limit.

    Args:
        edges: rest of the leg; the vehicle is on the first edge.
        nodes: the node at the end of each edge.
        position: position of the vehicle; None if unknown.
    """
    limits = [edge.max_speed for edge in edges[:1]]
    if position is not None:
        ahead = zip(edges[1:], _distances(nodes, position), strict=False)
        limits += [edge.max_speed for edge, distance in ahead if distance < _BRAKING_DISTANCE]
        if len(edges) > 1 and _is_near_edge(position.point, *nodes[:2]):
            # the robot may already be on this edge, if no report showed it at the node before
            limits.append(edges[1].max_speed)
    return min((limit for limit in limits if limit is not None), default=math.inf)


def _is_near_edge(here: Point, start: Node, end: Node) -> bool:
    """Return True if a point is within `_BRAKING_DISTANCE` of the line between two nodes.

    Return False if a node has no position.
    """
    if start.position is None or end.position is None:
        return False
    line = start.position.point, end.position.point
    return math.dist(here, nearest_on_line(here, *line)) < _BRAKING_DISTANCE


def _distances(nodes: Sequence[Node], position: Position) -> Iterator[float]:
    """Yield the distance to each node through the nodes before it, in metres."""
    distance, here = 0.0, position.point
    for node in nodes:
        if node.position is not None:
            distance += math.dist(here, node.position.point)
            here = node.position.point
        yield distance


@dataclass(frozen=True)
class Drive:
    """Command to drive a leg, and to report its end with `OrderMachine.drive_ended`."""

    leg: Leg


class Control(Enum):
    """Command to pause, resume or cancel the execution of something by the robot.

    From `OrderMachine`, it is about the drive of the current leg. When a cancelled drive has ended,
    call `OrderMachine.drive_ended`. `vda5050.robot` uses the same commands for each task and action
    of the robot. The values are the names of the commands in the log.
    """

    PAUSE = "pause"
    RESUME = "resumption"
    CANCEL = "cancellation"


@dataclass(frozen=True)
class Perform:
    """Command to perform an action, and to report its progress with `action_changed`.

    Attributes:
        at_once: True to wait neither for other actions nor for a standstill.
    """

    action: Action
    at_once: bool = False


@dataclass(frozen=True)
class EndAction:
    """Command to end an action: the vehicle has left its edge, or the order was cancelled.

    Attributes:
        reason: result of the action if it fails because of the command.
    """

    action: Action
    reason: str


Command: TypeAlias = Drive | Control | Perform | EndAction
"""Any command of `OrderMachine`; `InstantActions` has only `Perform`."""
