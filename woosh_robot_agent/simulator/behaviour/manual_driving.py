"""Driving without a job: by remote control, and by following a leader."""

from __future__ import annotations

from woosh_robot_agent.simulator.behaviour.jobs import is_clear
from woosh_robot_agent.simulator.body.base import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    Base,
    Velocity,
    approach,
)
from woosh_robot_agent.simulator.robot import Robot
from woosh_robot_agent.simulator.timeline import ROUNDING
from woosh_robot_agent.simulator.world.geometry import Point

_LEADER_DISTANCE = 1.0
"""Distance that a following robot keeps from its centre to its leader, in metres."""

_MAX_LEADER_DISTANCE = 3.0
"""Distance from the centre of the robot up to which it sees a leader, in metres."""

_MAX_LEADER_BEARING = 1.0
"""Bearing up to which the robot sees a leader, in radians."""

_MAX_DRIVING_BEARING = 0.3
"""Bearing of the leader from which on the robot only turns, in radians."""

_FOLLOWING_SPEED = 0.8
"""Maximum speed while following, in m/s."""


class Follower:
    """Follows the nearest obstacle ahead, its leader, at a distance. Without one the robot stands.

    Attributes:
        active: True if a client has ordered the robot to follow.
    """

    def __init__(self) -> None:
        self.active = False

    def tick(self, robot: Robot, dt: float) -> None:
        """Drive for `dt` seconds, if the robot follows and sees a leader."""
        leader = _leader(robot) if self.active else None
        if leader is None:
            return  # a base that is not driven slows down
        base = robot.base
        bearing = base.pose.bearing(leader)
        ahead = max(0.0, base.pose.distance(leader) - _LEADER_DISTANCE)
        drives = abs(bearing) < _MAX_DRIVING_BEARING and is_clear(robot, 0.0, ahead)
        speed = approach(ahead, _FOLLOWING_SPEED, ACCELERATION, dt) if drives else 0.0
        turn = approach(bearing, base.max_turn_rate, ANGULAR_ACCELERATION, dt)
        base.drive(Velocity(speed, 0.0, turn))


def _leader(robot: Robot) -> Point | None:
    """Return the middle of the nearest side of an obstacle that the robot sees; None if none."""
    pose = robot.base.pose
    sides = [
        ((wall.x1 + wall.x2) / 2.0, (wall.y1 + wall.y2) / 2.0) for wall in robot.obstacles.walls
    ]
    seen = [
        side
        for side in sides
        if pose.distance(side) <= _MAX_LEADER_DISTANCE
        and abs(pose.bearing(side)) <= _MAX_LEADER_BEARING
    ]
    return min(seen, key=pose.distance, default=None)


COMMAND_TIMEOUT = 0.5
"""Simulated time after which the base slows down unless a new command arrives, in seconds."""


class Teleop:
    """Drives the base by the last velocity command until the command times out.

    Args:
        start_delay: time from the first command to the first motion of a standing base, in seconds.
    """

    def __init__(self, start_delay: float) -> None:
        self._start_delay = start_delay
        self._until_start = 0.0
        """Remaining time until the base starts to move, in seconds; not positive if it may move."""
        self._velocity: Velocity | None = None
        """Velocity of the last command, None if there is none or it timed out."""
        self._left = 0.0
        """Remaining time until the last command times out, in seconds."""

    def command(self, velocity: Velocity) -> None:
        """Drive with this velocity until the next command, or until the timeout."""
        if self._velocity is None:
            self._until_start = self._start_delay
        self._velocity = velocity
        self._left = COMMAND_TIMEOUT

    def release(self) -> None:
        """Drop the last command. The base slows down."""
        self._velocity = None

    def tick(self, base: Base, dt: float) -> None:
        """Drive `base` for `dt` seconds if there is a command."""
        if self._velocity is None:
            return
        # Only a standing base needs time to start.
        self._until_start = 0.0 if base.moving else self._until_start - dt
        if self._until_start <= ROUNDING:
            base.drive(self._velocity, rolls_on=True)
        self._left -= dt
        if self._left <= ROUNDING:
            self.release()
