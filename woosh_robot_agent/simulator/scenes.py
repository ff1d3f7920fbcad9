"""The scenes that a simulated chassis starts with.

`wooshmap` is a hall of 24 by 20 m with two partitions, three pillars and a gate; `scenex` is the
same hall furnished differently, with a second, empty floor. Both have the marks that the interface
document's examples name, and stretches of free floor around the poses which it names.
"""

from __future__ import annotations

import math

from woosh_robot_agent.simulator.geometry import Pose, Wall, box
from woosh_robot_agent.simulator.maps import Map, Mark, MarkKind, Scene

START_SCENE = "wooshmap"
START_POSE = Pose(4.23276472, -6.6727581, -0.255771846)

_LOW, _HIGH = (-12.0, -10.0), (12.0, 10.0)

# The hall's outer walls; the east side has a gate of 2 m through which a laser sees nothing.
_HALL = (
    Wall(-12.0, -10.0, 12.0, -10.0),
    Wall(12.0, -10.0, 12.0, -1.0),
    Wall(12.0, 1.0, 12.0, 10.0),
    Wall(12.0, 10.0, -12.0, 10.0),
    Wall(-12.0, 10.0, -12.0, -10.0),
)
_WOOSHMAP = (
    *_HALL,
    Wall(-5.0, -10.0, -5.0, -2.5),
    Wall(-5.0, 4.0, -5.0, 10.0),
    *box(-0.4, -4.4, 0.4, -3.6),
    *box(8.6, 1.6, 9.4, 2.4),
    *box(-9.4, 3.6, -8.6, 4.4),
)
_SCENEX = (
    *_HALL,
    Wall(-5.0, -10.0, -5.0, -2.5),
    Wall(6.0, -10.0, 6.0, -5.0),
    *box(-3.0, -6.5, -1.0, -5.5),
    *box(-9.0, 5.0, -7.0, 6.0),
)


def _marks() -> dict[str, Mark]:
    quarter = math.pi / 2
    marks = (
        Mark(1, "A1", Pose(-2.0, 6.0, quarter), MarkKind.RACK, "rack by the north wall"),
        Mark(2, "A2", Pose(5.0, 4.0, 0.0), MarkKind.RACK, "rack in the east"),
        Mark(3, "A10", Pose(9.5, 7.0, quarter), MarkKind.PALLET_PLATFORM, "pallets"),
        Mark(4, "A23", Pose(-9.5, -7.5, math.pi), MarkKind.RACK, "rack behind the partition"),
        Mark(5, "K10", Pose(8.0, -4.0, -quarter), MarkKind.ROLLER_STATION, "conveyor"),
        Mark(6, "U5", Pose(1.0, -8.0, -quarter), MarkKind.LIFT_TROLLEY, "trolley"),
        Mark(7, "7613B5D", Pose(-8.0, 8.0, quarter), MarkKind.BASE, "inspection point"),
        Mark(8, "W1", Pose(3.0, 8.0, quarter), MarkKind.ARM_WORKTOP, "work top"),
        Mark(9, "T1", Pose(-3.0, -8.0, -quarter), MarkKind.TRACTOR_TRAILER, "trailer"),
        Mark(10, "C1", Pose(-10.8, 0.5, math.pi), MarkKind.CHARGER, "charger"),
        Mark(11, "P1", Pose(10.5, -8.5, quarter), MarkKind.PARKSPOT, "parking place"),
    )
    return {mark.number: mark for mark in marks}


def default_scenes() -> dict[str, Scene]:
    """Fresh copies of the scenes that every simulated chassis knows, by name."""
    marks = _marks()
    scenes = (
        Scene("wooshmap", [Map(0, "wooshmap", "1F", 147, _LOW, _HIGH, _WOOSHMAP, marks)]),
        Scene(
            "scenex",
            [
                Map(1, "scenex", "1F", 12, _LOW, _HIGH, _SCENEX, marks),
                Map(2, "scenex2", "2F", 3, _LOW, _HIGH, _HALL),
            ],
        ),
    )
    return {scene.name: scene for scene in scenes}
