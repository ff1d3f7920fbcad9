"""The route: the rest of an order, the place of the vehicle on it, and which nodes are reached.

A leg is a part of the route that the robot drives without a stop. A node counts as reached for one
of these reasons, and for no other:

- The vehicle stands on it: the first node of an order (`begin`), or a node at the place of the last
  node (`reach_in_place`).
- The vehicle passes it on a leg, within the permitted deviation. If it misses the node, a later
  node of the leg that it passes counts for both, once it has driven the distance to the missed node
  (`moved`). After a loss of the link, no node is passed until the robot confirms that it drives the
  leg: the robot may have been moved, or restarted elsewhere.
- The drive of the leg has ended without a failure (`arrive`).

Then the actions of the node are triggered. If the vehicle passes the node without a stop, and the
report that shows it is already far from the node, the actions fail instead.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise, takewhile

from woosh_robot_agent.vda5050.messages.geometry import Point, curve_points, nearest_on_line
from woosh_robot_agent.vda5050.messages.order import Edge, Node, NodePosition, Order
from woosh_robot_agent.vda5050.messages.state import Position
from woosh_robot_agent.vda5050.orders.actions import OrderActions
from woosh_robot_agent.vda5050.orders.legs import Leg

_SAME_PLACE = 0.01
"""Distance below which two nodes are at the same place, in metres."""
_MAX_STEP = 1.0
"""Maximum distance between two successive reports of a driving vehicle, in metres. It sends five
reports per second. A larger distance is a jump: the position was corrected, or somebody moved the
vehicle."""
_UNSEEN_DETOUR = math.sqrt(2.0)
"""Estimated length of a way that was driven without a link, per metre between its ends. A way round
one right-angled corner is at most so long."""
_TOLERANCE = 0.25
"""Lowest permitted deviation from a node, in metres; replaces a smaller one of the order."""
_ANGLE_TOLERANCE = 0.1
"""Lowest permitted deviation from the heading of a node, in radians."""


class Route:
    """The rest of an order, and the place of the vehicle on it.

    Args:
        actions: the actions of the order; reached nodes and entered edges trigger their actions.

    Attributes:
        last_node: the node that was reached last; None before the first node.
        nodes: nodes still to be reached.
        edges: edges still to be traversed to their end.
        on_edge: True if the vehicle is on the first of `edges`.
        leg: the leg that the vehicle drives; None while it drives no leg.
        position: the last known position; None before the first report, also after a restart.
        driven: distance driven since the last node, in metres; None if unknown after a restart.
        must_check_place: True if the vehicle may have been moved away from the last node.
        driven_to: last position to which the vehicle drove, i.e. was not pushed; None if unknown.
    """

    def __init__(self, actions: OrderActions) -> None:
        self._actions = actions
        self.last_node: Node | None = None
        self.nodes: deque[Node] = deque()
        self.edges: deque[Edge] = deque()
        self.on_edge = False
        self.leg: Leg | None = None
        self.position: Position | None = None
        self.driven: float | None = 0.0
        self.must_check_place = False
        self.driven_to: Position | None = None
        self._move_start: Position | None = None
        """Start of the last move, which ends at `position`; None if unknown."""
        self._reached_at: Position | NodePosition | None = None
        """Position of the vehicle when it reached the last node; after a restart, that of the node.
        None if unknown."""
        self._estimated_way = 0.0
        """Estimate of `driven` that allows for detours without a link; never unknown."""
        self._is_unconfirmed = False
        """True from a loss of the link on a leg, or a restart, until the robot confirms that it
        drives the leg, a leg begins, or `last_node` is set."""
        self._position_at_loss: Position | NodePosition | None = None
        """Last known position when `_is_unconfirmed` became True; after a restart, that of the last
        node. None if unknown."""

    # The order

    @property
    def parts(self) -> list[Node | Edge]:
        """The remaining nodes and edges, in the order of traversal."""
        return in_sequence(self.nodes, self.edges)

    def begin(self, order: Order) -> None:
        """Begin a new order: the vehicle stands on its first node."""
        self.nodes, self.edges = deque(order.nodes), deque(order.edges)
        self.on_edge = False
        self._reach()

    def append(self, order: Order) -> None:
        """Replace the horizon by an update, whose first node is the last one of the base."""
        self.nodes = deque(node for node in self.nodes if node.released)
        self.edges = deque(edge for edge in self.edges if edge.released)
        self.nodes += order.nodes[1:]
        self.edges += order.edges

    def empty(self) -> None:
        """Remove the remaining nodes and edges of the order."""
        self.on_edge = False
        self.nodes.clear()
        self.edges.clear()

    def restore(
        self, last_node: Node | None, nodes: Iterable[Node], edges: Iterable[Edge], *, on_edge: bool
    ) -> None:
        """Go on after a restart of the program; the position of the vehicle is not known yet."""
        self.last_node = last_node
        self.nodes, self.edges, self.on_edge = deque(nodes), deque(edges), on_edge
        self.driven = None
        self.must_check_place = self._is_unconfirmed = True
        self._reached_at = None if last_node is None else last_node.position
        self._position_at_loss = self._reached_at

    # Reasons why a node counts as reached

    def stands_on(self, node: Node) -> bool:
        """Return True if the vehicle stands on a node, within the permitted deviation."""
        if node.position is None or self.position is None:
            return False
        return is_reached(node.position, None, self.position)

    def set_last_node(self, node: Node | None) -> None:
        """Set the last node to a node on which the vehicle stands; None if it stands on no node."""
        self.last_node = node
        self._measure_from_here()

    def reach_in_place(self, node: Node) -> bool:
        """Reach the next node if it is at the place of the last node, and the vehicle stands there.

        Returns:
            True if the node was reached.
        """
        last = self.last_node
        if last is None or last.position is None or node.position is None:
            return False
        if node.mark:  # the robot drives to a mark even from the same place
            return False
        if math.dist(node.position.point, last.position.point) >= _SAME_PLACE:
            return False
        if not self.stands_on(node):
            return False
        self._reach()
        return True

    def moved(self, position: Position, *, by_action: bool, confirmed: bool, passes: bool) -> None:
        """Take a new position, and reach the nodes of the leg that the vehicle has passed.

        Args:
            position: the new position, also if it is the same as before.
            by_action: True if an action may have moved the vehicle.
            confirmed: True if the robot has confirmed, over the current link, that it drives the
                leg.
            passes: True if passed nodes count as reached; False while the order is cancelled.
        """
        last, was_in_place, leg = self.position, self.is_in_place, self.leg
        self.position = position
        self._measure_move(last, position, confirmed=confirmed)
        drives_leg = leg is not None and not self._is_unconfirmed
        # somebody may switch the map without moving the robot
        is_same_place = (
            was_in_place
            and last is not None
            and last.map_id != position.map_id
            and math.dist(last.point, position.point) <= _TOLERANCE
        )
        if by_action or drives_leg or is_same_place:
            self.driven_to = position
        elif position != last:  # pushed by somebody, or its position was corrected
            self.must_check_place = True
        if leg is None or not passes:
            return
        before_goal = takewhile(lambda node: node is not leg.goal, tuple(self.nodes))
        for _ in range(self._count_passed(position, tuple(self.edges), before_goal)):
            self._reach(passing=True)
            self.enter_edge()

    def _measure_move(self, last: Position | None, now: Position, *, confirmed: bool) -> None:
        """Update the distance driven, and the start of the last move.

        The first position of a confirmed drive ends `_is_unconfirmed`.
        """
        start = None if self._is_unconfirmed else last
        step = estimated_step = distance(start, now)
        if step > _MAX_STEP:  # a jump, or `start` is unknown
            start, step, estimated_step = None, 0.0, 0.0
        if self._is_unconfirmed and self.leg is not None and confirmed:
            # the way driven without a link: at least the straight line, perhaps a detour
            gap = distance(self._position_at_loss, now)
            step = gap if math.isfinite(gap) else 0.0
            estimated_step = step * _UNSEEN_DETOUR
            self._is_unconfirmed = False
        # a repeated report keeps the last move, unless the link was lost meanwhile
        if now != last or start is None:
            self._move_start = start
        self._estimated_way += estimated_step
        self.driven = None if self.driven is None else self.driven + step

    def arrive(self) -> None:
        """Reach the rest of the leg: its drive has ended without a failure."""
        assert self.leg is not None
        goal, self.leg = self.leg.goal, None
        while self.nodes[0] is not goal:
            self._reach(passing=True)
            self.enter_edge()
        self._reach()

    def _count_passed(self, here: Position, edges: Iterable[Edge], nodes: Iterable[Node]) -> int:
        """Return how many of the next nodes of the leg the vehicle has passed by its last move.

        A missed node counts with the next passed node, but only once the vehicle has driven at
        least the distance to the missed node, and moves away from it. Until then the vehicle may
        still be on its way to the missed node, and this way may lead past later nodes.

        Args:
            here: position of the vehicle, the end of its last move.
            edges: the edge to each node.
            nodes: the nodes of the leg before its goal, in their order.
        """
        if self._is_unconfirmed:
            return 0
        move_start = self._move_start
        count, way = 0, 0.0  # `way` is the length of the route from the last node to `previous`
        previous: Position | NodePosition | None = self._reached_at
        for number, (edge, node) in enumerate(zip(edges, nodes, strict=False)):
            place = node.position
            if place is None:
                break
            is_next = number == count  # no node before it is missed
            # matters only if a node is missed: then `previous` is the last missed node
            is_past_missed = self._estimated_way >= way and self._moves_away_from(previous)
            if (is_next or is_past_missed) and is_reached(place, move_start, here):
                count = number + 1
                if move_start is not None and move_start.map_id == here.map_id:
                    # the following nodes must be passed on the rest of the move
                    x, y = nearest_on_line(place.point, move_start.point, here.point)
                    move_start = replace(here, x=x, y=y)
            way += _length(edge, previous, place)
            previous = place
        return count

    def _moves_away_from(self, place: Position | NodePosition | None) -> bool:
        """Return True if the last move has not brought the vehicle nearer to a place.

        Return False if the last move is unknown.
        """
        if self._move_start is None:
            return False
        return distance(self.position, place) >= distance(self._move_start, place)

    def _reach(self, *, passing: bool = False) -> None:
        """Leave the current edge, if any, and reach the next node.

        Args:
            passing: True if the vehicle does not stop on the node, and may be past it by now.
        """
        if self.on_edge:
            self.on_edge = False
            self.edges.popleft()
            self._actions.leave_edge()
        self.last_node = self.nodes.popleft()
        is_far_past = passing and self._is_far_from(self.last_node)
        self._measure_from_here()
        if is_far_past:
            self._actions.fail_node(self.last_node)
        else:
            self._actions.trigger_node(self.last_node)

    def _is_far_from(self, node: Node) -> bool:
        """Return True if the vehicle is too far from a node for the actions of the node.

        Too far is more than the permitted deviation plus the way between two reports.
        """
        place, here = node.position, self.position
        if place is None or here is None:
            return False
        radius = place.deviation_xy
        if place.ellipse is not None:
            radius = max(place.ellipse.a, place.ellipse.b)
        return distance(here, place) > max(radius, _TOLERANCE) + _MAX_STEP

    # The leg, and the place of the vehicle

    def enter_edge(self) -> None:
        """Enter the first of `edges`, and trigger its actions."""
        self.on_edge = True
        self._actions.trigger_edge(self.edges[0])

    def begin_leg(self, leg: Leg) -> None:
        """Make a leg the one that the vehicle drives."""
        self.leg = leg
        self._is_unconfirmed = False  # the place was checked after a loss of the link

    def link_lost(self) -> None:
        """Pass no node until the robot confirms the drive, and check the place after it."""
        self.must_check_place = True
        if self.leg is not None and not self._is_unconfirmed:
            self._is_unconfirmed, self._position_at_loss = True, self.position

    @property
    def is_in_place(self) -> bool:
        """True if the vehicle stands on the last node, or is still where it drove by itself."""
        last = self.last_node
        if last is not None and self.stands_on(last):
            return True
        return distance(self.driven_to, self.position) <= _TOLERANCE

    @property
    def has_left_last_node(self) -> bool:
        """True if the vehicle does not stand on the last node any more.

        The place of a node without a position, e.g. of initPosition, is where it was reached.
        """
        last = self.last_node
        if last is not None and last.position is None:
            return distance(self._reached_at, self.position) > _TOLERANCE
        return last is not None and not self.stands_on(last)

    def is_on_map_of(self, node: Node) -> bool:
        """Return True if the vehicle is on the map of a node, or if one of the maps is unknown."""
        if node.position is None or self.position is None:
            return True
        return node.position.map_id == self.position.map_id

    def distance_to_trajectory(self, leg: Leg) -> float:
        """Return the distance to the start of the leg's trajectory, in metres; 0 without one."""
        trajectory = leg.edges[0].trajectory
        if trajectory is None or self.position is None:
            return 0.0
        return math.dist(curve_points(trajectory)[0], self.position.point)

    def _measure_from_here(self) -> None:
        """Measure the driven distance from the current position, because `last_node` was set."""
        self.driven, self._estimated_way, self._reached_at = 0.0, 0.0, self.position
        self._is_unconfirmed = False


def in_sequence(nodes: Iterable[Node], edges: Iterable[Edge]) -> list[Node | Edge]:
    """Return nodes and edges in the order of traversal."""
    parts: list[Node | Edge] = [*nodes, *edges]
    return sorted(parts, key=lambda part: part.sequence_id)


def is_reached(node: NodePosition, before: Position | None, now: Position) -> bool:
    """Return True if the vehicle has passed a node on its straight way from `before` to `now`.

    If `before` is None, or on another map, the vehicle must be at the node now. If the node demands
    a heading, that of the vehicle must fit, too.
    """
    if node.map_id != now.map_id:
        return False
    if before is None or before.map_id != now.map_id:
        before = now
    if not _is_within(node, before, now):
        return False
    if node.theta is None:
        return True
    error = math.remainder(node.theta - now.theta, math.tau)
    return abs(error) <= max(abs(node.deviation_theta), _ANGLE_TOLERANCE)


def _is_within(node: NodePosition, before: Position, now: Position) -> bool:
    """Return True if a straight way leads through the permitted deviation from a node."""
    if node.ellipse is None:
        nearest = nearest_on_line(node.point, before.point, now.point)
        return math.dist(node.point, nearest) <= max(node.deviation_xy, _TOLERANCE)
    a, b = max(node.ellipse.a, _TOLERANCE), max(node.ellipse.b, _TOLERANCE)
    cos, sin = math.cos(node.ellipse.theta), math.sin(node.ellipse.theta)

    def scaled(place: Position) -> Point:
        """Return the place in axes in which the ellipse is a circle of radius 1 at the origin."""
        x, y = place.x - node.x, place.y - node.y
        return (x * cos + y * sin) / a, (y * cos - x * sin) / b

    return math.hypot(*nearest_on_line((0.0, 0.0), scaled(before), scaled(now))) <= 1.0


def _length(edge: Edge, start: Position | NodePosition | None, end: NodePosition) -> float:
    """Return the length of an edge, in metres.

    Without a trajectory, it is infinite if the start is unknown, or on another map than the end.
    """
    if edge.trajectory is not None:
        return sum(math.dist(*points) for points in pairwise(curve_points(edge.trajectory)))
    return distance(start, end)


def distance(start: Position | NodePosition | None, end: Position | NodePosition | None) -> float:
    """Return the distance of two places, in metres; infinite if unknown, or on different maps."""
    if start is None or end is None or start.map_id != end.map_id:
        return math.inf
    return math.dist(start.point, end.point)
