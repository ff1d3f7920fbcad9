"""Odometry from a robot that says only where it is in its map.

The chassis reports one pose, in its map, corrected by its localisation. REP 105 wants two
transforms: `odom` -> `base_link`, which never jumps, and `map` -> `odom`, which takes the jumps.
So each report is compared with the one before: what the robot can have driven meanwhile moves
`odom`, all else, such as a pose that somebody set, moves `map` -> `odom`. The small corrections by
which the chassis's localisation follows the laser cannot be told from driving and are part of
`odom`.
"""

from __future__ import annotations

import math

from woosh_robot_agent.standard.plane import Plane

MOST_SPEED_MPS = 1.5
MOST_TURN_RADPS = 2.0
"""Faster than the robot can be."""
_LATE_S = 0.3
"""How much later than the one before a report may come by the network's fault."""
_LONGEST_S = 0.5
"""A moving robot reports more often than this; a longer silence was standing still."""
_REST_M = 0.1
_REST_RAD = 0.1
"""How far a robot can be moved between two reports that both say that it stands: sideways, of
which reports say nothing."""
_PLACED_S = 0.3
"""How long after it was told where it is the robot may report a pose from before."""
_PLACED_M = 0.05
_PLACED_RAD = 0.05
"""How much a report may then differ from what the speed says before it counts as the jump."""
_LEAST_SIDEWAYS_M = 0.004
"""Less than this between two reports is the curve that the robot drives, not sideways driving."""


class Odometry:
    """Where the robot is in `odom`, and where `odom` is in `map`.

    Attributes:
        pose: pose of the robot in `odom`; continuous for as long as this object lives.
        map_to_odom: pose of `odom` in `map`.
        forward: speed ahead in m/s.
        sideways: speed to the left in m/s, from the poses: reports do not have it.
        turn: rad/s.
    """

    def __init__(self) -> None:
        self.pose = Plane()
        self.map_to_odom = Plane()
        self.forward = 0.0
        self.sideways = 0.0
        self.turn = 0.0
        self._time = -math.inf
        self._map_id = 0
        self._known = False
        self._placed_until = -math.inf

    @property
    def map_pose(self) -> Plane:
        """Pose of the robot in `map`, as it was reported last."""
        return self.map_to_odom * self.pose

    @property
    def moving(self) -> bool:
        """Whether the last report said that the robot moves."""
        return bool(self.forward or self.turn or self.sideways)

    def lost(self) -> None:
        """Nobody knows what happens until the next report: it says nothing about driving."""
        self._known = False

    def placed(self, time: float) -> None:
        """Somebody told the robot at `time` where it is: a report after that jumps there."""
        self._placed_until = time + _PLACED_S

    def update(
        self, reported: Plane, forward: float, turn: float, map_id: int, time: float
    ) -> None:
        """Take a report of the chassis.

        Args:
            reported: pose in the map.
            forward: speed ahead in m/s.
            turn: turning speed in rad/s.
            map_id: number of the map.
            time: s at which it came, by any clock that only goes forward.
        """
        moved = self.map_pose.inverse * reported
        lasted = min(max(time - self._time, 0.0), _LONGEST_S)
        if not self._known:
            self.map_to_odom = reported * self.pose.inverse
            self.sideways = 0.0
        elif map_id != self._map_id or self._jumped(moved, forward, turn, lasted, time):
            self.pose = self.pose * _arc(forward, turn, lasted)
            self.map_to_odom = reported * self.pose.inverse
            self.sideways = 0.0
            self._placed_until = -math.inf
        else:
            self.pose = self.pose * moved
            aside = moved.y if abs(moved.y) > _LEAST_SIDEWAYS_M else 0.0
            self.sideways = aside / max(lasted, 0.02)
        self.forward, self.turn = forward, turn
        self._time, self._map_id = time, map_id
        self._known = True

    def _jumped(
        self, moved: Plane, forward: float, turn: float, lasted: float, time: float
    ) -> bool:
        """Whether the robot cannot have driven so far since the report before."""
        if time <= self._placed_until:  # the smallest difference is likely to be a jump
            off = _arc(forward, turn, lasted).inverse * moved
            return off.distance > _PLACED_M or abs(off.theta) > _PLACED_RAD
        if not (forward or turn or self.forward or self.turn):
            return moved.distance > _REST_M or abs(moved.theta) > _REST_RAD
        seconds = lasted + _LATE_S
        return (
            moved.distance > MOST_SPEED_MPS * seconds
            or abs(moved.theta) > MOST_TURN_RADPS * seconds
        )


def _arc(forward: float, turn: float, seconds: float) -> Plane:
    """How far these speeds bring the robot."""
    ahead, turned = forward * seconds, turn * seconds
    return Plane(ahead * math.cos(turned / 2), ahead * math.sin(turned / 2), turned)
