"""Collision detection for a moving base."""

from __future__ import annotations

import math

from woosh_robot_agent.simulator.world.footprints import Outline
from woosh_robot_agent.simulator.world.geometry import Point, Pose, Wall
from woosh_robot_agent.simulator.world.hull import hull
from woosh_robot_agent.simulator.world.maps import Map
from woosh_robot_agent.simulator.world.obstacles import Obstacles


class CollisionDetector:
    """Computes gaps for a moving base, and skips the computation while nothing is near."""

    def __init__(self) -> None:
        self._surroundings: tuple[Map, tuple[Wall, ...]] | None = None
        self._centre: Point = (0.0, 0.0)
        """Position at which the clearance was last computed, in metres."""
        self._clearance = 0.0
        """Clearance at that position, in metres."""

    def gap(self, outline: Outline, pose: Pose, area: Map, obstacles: Obstacles) -> float:
        """Return the gap in metres between the outline at `pose` and walls and obstacles.

        See `hull` for its definition. It is infinite if nothing is within the outline's radius.
        """
        shape = hull(outline)
        known = self._surroundings
        if known is None or known[0] is not area or known[1] is not obstacles.walls:
            self._surroundings = (area, obstacles.walls)
            self._clearance = 0.0
        if self._clearance - pose.distance(self._centre) > shape.radius:
            return math.inf
        self._centre = pose.point
        self._clearance = min(area.clearance(*self._centre), obstacles.clearance(*self._centre))
        self._clearance -= area.clearance_error
        if self._clearance > shape.radius:
            return math.inf
        return min(area.gap(shape, pose), shape.gap(pose, obstacles.walls))
