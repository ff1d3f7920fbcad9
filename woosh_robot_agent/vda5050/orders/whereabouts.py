"""Where the vehicle is, and whether it is still where it has brought itself."""

from __future__ import annotations

import math

from woosh_robot_agent.vda5050.model.order import Node, NodePosition
from woosh_robot_agent.vda5050.model.state import Position
from woosh_robot_agent.vda5050.orders.curve import curve_points
from woosh_robot_agent.vda5050.orders.legs import Leg
from woosh_robot_agent.vda5050.orders.reach import Tolerance, is_reached

_SAME_PLACE = 0.01
"""Distance of two nodes that are at the same place, in metres."""


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
        """The position before the last one; None if there was none."""
        self._stand: Position | None = None
        """Where the vehicle has brought itself last; None if unknown."""

    def moved(self, position: Position, *, by_itself: bool) -> None:
        """Take a new position.

        Args:
            position: the position.
            by_itself: neither people nor other programs have moved the vehicle.
        """
        before, self._before, self.position = self.position, self.position, position
        is_on_other_map = before is not None and before.map_id != position.map_id
        if by_itself or is_on_other_map:
            self._stand = position
        elif position != before:
            self.doubtful = True
        if before is not None and not is_on_other_map and self.driven is not None:
            self.driven += math.hypot(position.x - before.x, position.y - before.y)

    def has_passed(self, place: NodePosition) -> bool:
        """Return True if the vehicle has passed a node since the position before the last one."""
        here = self.position
        return here is not None and is_reached(place, self._before, here, self._tolerance)

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
