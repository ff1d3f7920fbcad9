"""Routes: paths on the map along given poses, without driving them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.world.footprints import outer_radius
from woosh_robot_agent.simulator.world.geometry import Point, Pose, Wall
from woosh_robot_agent.simulator.world.planner import SearchBudget, SearchBudgetError, planner

PATH_MARGIN = 0.05
"""Clearance of planned paths in addition to the radius of the robot, in metres."""


class NoRouteError(Exception):
    """There is no route. The text is the reason, then after a colon what to do."""


@dataclass(frozen=True, slots=True)
class Route:
    """A planned route.

    Attributes:
        legs: Corners on the way to each stop, the stop last.
        poses: The start, each corner with the direction in which the robot arrives there, and the
            last stop.
    """

    legs: tuple[tuple[Point, ...], ...]
    poses: tuple[Pose, ...]

    @property
    def length(self) -> float:
        """Length, in metres."""
        return sum(here.distance(there.point) for here, there in pairwise(self.poses))


def plan_route(
    robot: Robot,
    start: Pose,
    stops: Iterable[Pose],
    *,
    strict: bool = False,
    obstacles: tuple[Wall, ...] = (),
) -> Route:
    """Plan a route for the robot with its footprint in use.

    Args:
        robot: The robot.
        start: Pose at which the route starts.
        stops: Poses to pass, the goal last.
        strict: Connect the poses by straight lines.
        obstacles: Walls to avoid in addition to those of the map.

    Raises:
        NoRouteError: There is no route, or it takes too long to find one.
    """
    routes = planner(robot.map, outer_radius(robot.outline) + PATH_MARGIN)
    budget = SearchBudget()
    here = start.point
    legs: list[tuple[Point, ...]] = []
    poses = [start]
    goal = start
    for goal in stops:
        try:
            leg = [goal.point] if strict else routes.plan(here, goal.point, obstacles, budget)
        except SearchBudgetError:
            raise NoRouteError(
                f"the way to {goal} is too long or too winding to plan: choose a nearer goal, "
                "or add poses on the way, each in sight of the next"
            ) from None
        if leg is None:
            raise NoRouteError(f"no free path to {goal}: choose a goal on free floor")
        for corner in leg:
            poses.append(Pose(*corner, math.atan2(corner[1] - here[1], corner[0] - here[0])))
            here = corner
        legs.append(tuple(leg))
    poses[-1] = goal
    return Route(tuple(legs), tuple(poses))
