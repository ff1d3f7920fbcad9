"""The footprints of the robot, one of which is in use."""

from __future__ import annotations

import math

from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator.world.geometry import Point

Outline = tuple[Point, ...]
"""Corners in the frame of the base (x forward, y left), in metres."""

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


FOOTPRINTS: dict[int, Outline] = {
    util_robot_pb2.kOriginal: _ORIGINAL,
    util_robot_pb2.kExpand: _grown(0.15),
    util_robot_pb2.kSpare: _grown(0.05),
    util_robot_pb2.kDock: _grown(-0.05),
}
"""Outlines by `woosh.robot.FootPrint`: as built, with goods on top, a spare one, for docking."""


def outer_radius(outline: Outline) -> float:
    """Return the radius of the circle in which the robot turns on the spot, in metres."""
    return max(math.hypot(x, y) for x, y in outline)
