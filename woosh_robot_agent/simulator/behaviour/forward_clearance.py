"""Looking ahead: does anything that is not on the map stand in the way?"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from woosh_robot_agent.simulator.body.base import ACCELERATION_MPS2
from woosh_robot_agent.simulator.world.footprints import FOOTPRINTS

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.chassis import Chassis

#: The gap in m that a stopped robot leaves between its outline and what it stopped for.
_GAP_M = 0.3
_BESIDE_M = 0.05
_ROUNDING_M = 5e-3


def way_is_free(chassis: Chassis, direction: float, distance: float) -> bool:
    """Whether the base can go on in a direction without coming too near to an obstacle.

    Args:
        chassis: Whose base and obstacles.
        direction: rad from straight ahead, counter-clockwise.
        distance: How far it wants to go, in m; what stands further away does not matter.
    """
    obstacles = chassis.obstacles.walls
    if not obstacles:
        return True
    cos, sin = math.cos(direction), math.sin(direction)
    outline = FOOTPRINTS[chassis.footprint]
    front = max(x * cos + y * sin for x, y in outline)
    beside = max(y * cos - x * sin for x, y in outline) + _BESIDE_M
    braking = chassis.base.velocity.speed**2 / (2.0 * ACCELERATION_MPS2)
    # The far end of the corridor is round, as wide as the corridor.
    reach = min(distance, max(0.0, braking + front + _GAP_M - beside))
    here = chassis.base.pose
    there = here.moved(reach * cos, reach * sin, 0.0).point
    for wall in obstacles:
        # What is too near already must only not come nearer: the robot may leave.
        room = min(beside, wall.distance(*here.point) - _ROUNDING_M)
        if wall.line_distance(here.point, there) < room:
            return False
    return True
