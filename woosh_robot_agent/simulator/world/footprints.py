"""The footprints of the robot, one of which is in use."""

from __future__ import annotations

import math

from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator.world.geometry import Point

Outline = tuple[Point, ...]
"""Corners in the frame of the base (x forward, y left), in metres."""


def footprints(original: Outline) -> dict[int, Outline]:
    """Return the outlines of a robot by `woosh.robot.FootPrint`.

    They are the robot as built, with goods on top, a spare one, and for docking.

    Args:
        original: Outline of the robot as built.
    """
    return {
        util_robot_pb2.kOriginal: original,
        util_robot_pb2.kExpand: _grown(original, 0.15),
        util_robot_pb2.kSpare: _grown(original, 0.05),
        util_robot_pb2.kDock: _grown(original, -0.05),
    }


def _grown(outline: Outline, margin: float) -> Outline:
    return tuple((x + math.copysign(margin, x), y + math.copysign(margin, y)) for x, y in outline)


def outer_radius(outline: Outline) -> float:
    """Return the radius of the circle in which the robot turns on the spot, in metres."""
    return max(math.hypot(x, y) for x, y in outline)
