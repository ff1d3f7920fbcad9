"""Following whoever walks before the robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from woosh_robot_agent.simulator.behaviour.forward_clearance import way_is_free
from woosh_robot_agent.simulator.body.base import (
    ACCELERATION_MPS2,
    ACCELERATION_RADPS2,
    MAX_TURN_RADPS,
    Velocity,
    approach,
)
from woosh_robot_agent.simulator.world.geometry import Point

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.chassis import Chassis

#: From the robot's centre to the nearest side of the leader.
_GAP_M = 1.0
_SIGHT_M = 3.0
_SIGHT_RAD = 1.0
_STRAIGHT_RAD = 0.3
_SPEED_MPS = 0.8


class Follower:
    """Keeps a gap to the nearest thing before the robot that is not on the map.

    A robot that sees nobody stands and waits.

    Attributes:
        active: It was told to follow.
    """

    def __init__(self) -> None:
        self.active = False

    def start(self) -> None:
        """Follow from now on."""
        self.active = True

    def stop(self) -> None:
        """Follow nobody: the base slows down."""
        self.active = False

    def tick(self, chassis: Chassis, dt: float) -> None:
        """Command the next `dt` seconds."""
        leader = _leader(chassis) if self.active else None
        if leader is None:
            return
        base = chassis.base
        bearing = base.pose.bearing(leader)
        ahead = max(0.0, base.pose.distance(leader) - _GAP_M)
        straight = abs(bearing) < _STRAIGHT_RAD and way_is_free(chassis, 0.0, ahead)
        speed = approach(ahead, _SPEED_MPS, ACCELERATION_MPS2, dt) if straight else 0.0
        turn = approach(bearing, MAX_TURN_RADPS, ACCELERATION_RADPS2, dt)
        base.drive(Velocity(speed, 0.0, turn))


def _leader(chassis: Chassis) -> Point | None:
    """The middle of the nearest side of an obstacle in sight."""
    pose = chassis.base.pose
    sides = [
        ((wall.x1 + wall.x2) / 2.0, (wall.y1 + wall.y2) / 2.0) for wall in chassis.obstacles.walls
    ]
    seen = [
        side
        for side in sides
        if pose.distance(side) <= _SIGHT_M and abs(pose.bearing(side)) <= _SIGHT_RAD
    ]
    return min(seen, key=pose.distance, default=None)
