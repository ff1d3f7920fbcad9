"""The outlines that the chassis can be told to keep clear of obstacles."""

from __future__ import annotations

import math

from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator.world.geometry import Point

Outline = tuple[Point, ...]

_ORIGINAL: Outline = (
    (0.35, 0.265),
    (0.4, 0.215),
    (0.4, -0.215),
    (0.35, -0.265),
    (-0.35, -0.265),
    (-0.4, -0.215),
    (-0.4, 0.215),
    (-0.35, 0.265),
)


def _grown(margin: float) -> Outline:
    return tuple((x + math.copysign(margin, x), y + math.copysign(margin, y)) for x, y in _ORIGINAL)


#: Corners in m in the base's frame (x forward, y left), by `woosh.robot.FootPrint`: as built, with
#: goods on its back, a spare, and the close one for docking.
FOOTPRINTS: dict[int, Outline] = {
    util_robot_pb2.kOriginal: _ORIGINAL,
    util_robot_pb2.kExpand: _grown(0.15),
    util_robot_pb2.kSpare: _grown(0.05),
    util_robot_pb2.kDock: _grown(-0.05),
}


def outer_radius(outline: Outline) -> float:
    """The radius in m within which the robot can turn on the spot."""
    return max(math.hypot(x, y) for x, y in outline)
