"""Where the vehicle is, and why a node counts as reached.

A node counts as reached for one of these reasons, and for no other:

- The vehicle stands on it: the first node of an order, or one at the place of the last node.
- The vehicle passes it on a leg, within the permitted deviation.
- The vehicle passes a later node of the leg, after the way to there.
- The drive of the leg has ended without a failure; `OrderMachine.drive_ended` takes this one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

from woosh_robot_agent.vda5050.messages.order import Edge, Node, NodePosition, Order
from woosh_robot_agent.vda5050.messages.state import Position
from woosh_robot_agent.vda5050.orders.legs import Leg, curve_points, stops

_SAME_PLACE = 0.01
"""Distance of two nodes that are at the same place, in metres."""
_MAX_STEP = 1.0
"""Maximum distance between two reports of a vehicle that drives, in metres; beyond, it has jumped.
A robot sends five reports per second."""

_UNSEEN_WAY = math.sqrt(2.0)
"""Length of a way that was driven without a link, per distance of its ends: round a corner."""


@dataclass(frozen=True)
class Tolerance:
    """Minimum tolerance at a node; a smaller permitted deviation is raised to it.

    Attributes:
        xy: distance, in metres.
        theta: angle, in radians.
    """

    xy: float = 0.25
    theta: float = 0.1


class Whereabouts:
    """The position of the vehicle, and what it says about nodes.

    Args:
        tolerance: deviation from a node that counts as none.

    Attributes:
        position: the last position; None if unknown.
        driven: distance since the last node, in metres; None if unknown.
        doubtful: True if the vehicle may have been moved away from the last node.
    """

    def __init__(self, tolerance: Tolerance) -> None:
        self._tolerance = tolerance
        self.position: Position | None = None
        self.driven: float | None = 0.0
        self.doubtful = False
        self._before: Position | None = None
        """The position from which the vehicle has driven to the last one; None if unknown."""
        self._stand: Position | None = None
        """Where the vehicle has brought itself last; None if unknown."""
        self._left: Position | NodePosition | None = None
        """Where the vehicle was when it reached the last node; None if unknown."""
        self._way = 0.0
        """Distance that the vehicle has driven since then, in metres; estimated without a link."""
        self._is_lost = False
        """True if the vehicle may have been moved, or restarted elsewhere, during the leg."""
        self._lost_at: Position | NodePosition | None = None
        """Where it was before that; None if unknown."""

    def moved(self, position: Position, *, by_itself: bool, on_leg: bool, confirmed: bool) -> None:
        """Take a new position.

        Args:
            position: the position.
            by_itself: an action may have moved the vehicle.
            on_leg: the vehicle drives a leg.
            confirmed: the robot has confirmed, over the current link, that it drives the leg.
        """
        last, self.position = self.position, position
        before = None if self._is_lost else last
        step = _distance(before, position)
        if step > _MAX_STEP:
            before, step = None, 0.0
        if self._is_lost and on_leg and confirmed:
            gap = _distance(self._lost_at, position)
            step = gap if math.isfinite(gap) else 0.0
            self._way += step * (_UNSEEN_WAY - 1.0)
            self._is_lost = False
        self._before = before
        self._way += step
        self.driven = None if self.driven is None else self.driven + step
        is_on_other_map = last is not None and last.map_id != position.map_id
        if by_itself or (on_leg and not self._is_lost) or is_on_other_map:
            self._stand = position
        elif position != last:
            self.doubtful = True

    def lose_track(self) -> None:
        """Count no node of the leg until the robot confirms that it drives it.

        The link is lost: the robot may have been moved, or restarted elsewhere.
        """
        if not self._is_lost:
            self._is_lost, self._lost_at = True, self.position

    def restored(self, last: Node | None) -> None:
        """Know nothing but the node that was reached last, after a restart of the program."""
        self.driven = None
        self.doubtful = self._is_lost = True
        self._left = self._lost_at = None if last is None else last.position

    def departed(self) -> None:
        """Begin a leg, at a place that was checked."""
        self._is_lost = False

    def left(self) -> None:
        """Measure the way from here: the vehicle has reached a node."""
        self.driven, self._way, self._left = 0.0, 0.0, self.position
        self._is_lost = False

    def reached(self, edges: Iterable[Edge], nodes: Iterable[Node]) -> int:
        """Return how many of the next nodes of the leg the vehicle has reached by its last move.

        A node that was missed counts with the next one that is passed, once the vehicle has driven
        as far as to the missed one at least, and moves away from it: the way there may lead past
        later nodes.

        Args:
            edges: the edge to each of the nodes.
            nodes: the nodes that are passed without a stop, in their order.
        """
        here, before = self.position, self._before
        if here is None or self._is_lost:
            return 0
        count, way = 0, 0.0
        start: Position | NodePosition | None = self._left
        for number, (edge, node) in enumerate(zip(edges, nodes, strict=False)):
            place = node.position
            if place is None:
                break
            is_next = number == count or (self._way >= way and self._leaves(start))
            if is_next and is_reached(place, before, here, self._tolerance):
                count = number + 1
                before = None if before is None else _nearest(place, before, here)
            way += _length(edge, start, place)
            start = place
        return count

    def _leaves(self, place: Position | NodePosition | None) -> bool:
        """Return True if the vehicle moves away from a place."""
        if self._before is None:
            return False
        return _distance(self.position, place) >= _distance(self._before, place)

    def is_far_from(self, node: Node) -> bool:
        """Return True if the vehicle is so far from a node that it must have passed it unseen.

        That is, further than it drives between two reports. Actions of the node would happen
        somewhere else.
        """
        place, here = node.position, self.position
        if place is None or here is None:
            return False
        radius = place.deviation_xy
        if place.ellipse is not None:
            radius = max(place.ellipse.a, place.ellipse.b)
        return _distance(here, place) > max(radius, self._tolerance.xy) + _MAX_STEP

    def stands_on(self, node: Node) -> bool:
        """Return True if the vehicle stands on a node, within the permitted deviation."""
        if node.position is None or self.position is None:
            return False
        return is_reached(node.position, None, self.position, self._tolerance)

    def stands_on_both(self, last: Node, node: Node) -> bool:
        """Return True if two nodes are at the same place, and the vehicle stands there."""
        if last.position is None or node.position is None or node.mark:
            return False
        apart = math.hypot(node.position.x - last.position.x, node.position.y - last.position.y)
        return apart < _SAME_PLACE and self.stands_on(node)

    def is_where_it_stood(self) -> bool:
        """Return True if the vehicle is where it has brought itself."""
        here, stand = self.position, self._stand
        if here is None or stand is None or here.map_id != stand.map_id:
            return False
        return math.hypot(here.x - stand.x, here.y - stand.y) <= self._tolerance.xy

    def is_on_map_of(self, node: Node) -> bool:
        """Return True if the vehicle is on the map of a node, or that is unknown."""
        if node.position is None or self.position is None:
            return True
        return node.position.map_id == self.position.map_id

    def distance_to_way(self, leg: Leg) -> float:
        """Return the distance to the trajectory with which a leg begins, in metres; 0 without."""
        trajectory, here = leg.edges[0].trajectory, self.position
        if trajectory is None or here is None:
            return 0.0
        x, y = curve_points(trajectory)[0]
        return math.hypot(x - here.x, y - here.y)


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
    nearest = _nearest(node, before, now)
    return math.hypot(node.x - nearest.x, node.y - nearest.y)


def _nearest(node: NodePosition, before: Position, now: Position) -> Position:
    """Return the position nearest to a node on the straight way between two positions."""
    along_x, along_y = now.x - before.x, now.y - before.y
    length = along_x**2 + along_y**2
    if not length or before.map_id != now.map_id:
        return now
    part = ((node.x - before.x) * along_x + (node.y - before.y) * along_y) / length
    part = min(1.0, max(0.0, part))
    return replace(now, x=before.x + part * along_x, y=before.y + part * along_y)


def _length(edge: Edge, start: Position | NodePosition | None, end: NodePosition) -> float:
    """Return the length of an edge, in metres; infinite if it is unknown where it begins."""
    if edge.trajectory is not None:
        return sum(math.dist(*points) for points in pairwise(curve_points(edge.trajectory)))
    return _distance(start, end)


def _distance(start: Position | NodePosition | None, end: Position | NodePosition | None) -> float:
    """Return the distance of two places, in metres; infinite if it is unknown."""
    if start is None or end is None or start.map_id != end.map_id:
        return math.inf
    return math.hypot(end.x - start.x, end.y - start.y)


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
