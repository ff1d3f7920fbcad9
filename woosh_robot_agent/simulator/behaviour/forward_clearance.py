"""Checks whether an obstacle is in the way of the base."""

from __future__ import annotations

import math

from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.body.base import ACCELERATION

_STOP_GAP = 0.3
"""Gap between the outline of a stopped robot and the obstacle, in metres."""

_SIDE_GAP = 0.05
"""Gap between the outline and obstacles beside the path, in metres."""

_TOLERANCE = 5e-3
"""Tolerance for obstacles that are already too close, in metres."""


def is_clear(robot: Robot, direction: float, distance: float) -> bool:
    """Return True if the base can go on without coming too close to an obstacle.

    Args:
        robot: The robot.
        direction: Direction of the motion from straight ahead, in radians.
        distance: Length of the motion, in metres. Obstacles further away are ignored.
    """
    obstacles = robot.obstacles.walls
    if not obstacles:
        return True
    cos, sin = math.cos(direction), math.sin(direction)
    outline = robot.outline
    front = max(x * cos + y * sin for x, y in outline)
    half_width = max(y * cos - x * sin for x, y in outline) + _SIDE_GAP
    braking = robot.base.velocity.speed**2 / (2.0 * ACCELERATION)
    # The checked area is a corridor with a round end of the same width.
    length = min(distance, max(0.0, braking + front + _STOP_GAP - half_width))
    here = robot.base.pose
    there = here.moved(length * cos, length * sin, 0.0).point
    for wall in obstacles:
        # The robot may move away from an obstacle that is already too close.
        limit = min(half_width, wall.distance(*here.point) - _TOLERANCE)
        if wall.line_distance(here.point, there) < limit:
            return False
    return True
