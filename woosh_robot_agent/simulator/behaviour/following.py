"""Following a leader: the nearest obstacle ahead."""

from __future__ import annotations

from woosh_robot_agent.simulator.behaviour.forward_clearance import is_clear
from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.body.base import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    MAX_TURN_RATE,
    Velocity,
    approach,
)
from woosh_robot_agent.simulator.world.geometry import Point

_DISTANCE = 1.0
"""Distance from the robot's centre to the nearest side of the leader, in metres."""

_MAX_DISTANCE = 3.0
"""Distance up to which the robot sees a leader, in metres."""

_MAX_BEARING = 1.0
"""Angle from straight ahead up to which the robot sees a leader, in radians."""

_MAX_DRIVING_BEARING = 0.3
"""Angle from straight ahead up to which the robot drives while it turns, in radians."""

_SPEED = 0.8
"""Maximum speed, in m/s."""


class Follower:
    """Keeps a distance to the nearest obstacle ahead. Without one the robot stands still.

    Attributes:
        active: A client has ordered the robot to follow.
    """

    def __init__(self) -> None:
        self.active = False

    def start(self) -> None:
        """Start following."""
        self.active = True

    def stop(self) -> None:
        """Stop following. The base slows down."""
        self.active = False

    def tick(self, robot: Robot, dt: float) -> None:
        """Drive for `dt` seconds."""
        leader = _leader(robot) if self.active else None
        if leader is None:
            return
        base = robot.base
        bearing = base.pose.bearing(leader)
        ahead = max(0.0, base.pose.distance(leader) - _DISTANCE)
        drives = abs(bearing) < _MAX_DRIVING_BEARING and is_clear(robot, 0.0, ahead)
        speed = approach(ahead, _SPEED, ACCELERATION, dt) if drives else 0.0
        turn = approach(bearing, MAX_TURN_RATE, ANGULAR_ACCELERATION, dt)
        base.drive(Velocity(speed, 0.0, turn))


def _leader(robot: Robot) -> Point | None:
    """Return the middle of the nearest visible side of an obstacle."""
    pose = robot.base.pose
    sides = [
        ((wall.x1 + wall.x2) / 2.0, (wall.y1 + wall.y2) / 2.0) for wall in robot.obstacles.walls
    ]
    seen = [
        side
        for side in sides
        if pose.distance(side) <= _MAX_DISTANCE and abs(pose.bearing(side)) <= _MAX_BEARING
    ]
    return min(seen, key=pose.distance, default=None)
