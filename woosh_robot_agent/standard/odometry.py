"""Odometry from a robot that says only where it is in its map.

The chassis reports one pose, in its map, corrected by its localisation. REP 105 wants two
transforms: `odom` -> `base_link`, which never jumps, and `map` -> `odom`, which takes the jumps.
So each report is compared with the one before: what the robot can have driven meanwhile, at the
speeds that both reports tell, moves `odom`; all else, such as a pose that somebody set, moves
`map` -> `odom`. The small corrections by which the chassis's localisation follows the laser cannot
be told from driving and are part of `odom`.
"""

from __future__ import annotations

import math

from woosh_robot_agent.standard.plane import Plane

MOST_SPEED_MPS = 1.5
"""Faster than the robot can be."""
_LATE_S = 0.3
"""How much more time than has passed between two reports may be between what they report."""
_LONGEST_S = 0.5
"""A moving robot reports more often than this; a longer silence was standing still."""
_OFF_M = 0.03
_OFF_RAD = 0.03
"""How much a report may differ from the speeds, along the robot and in its heading."""
_ASIDE_M = 0.1
"""The same sideways: reports do not have that speed."""
_PLACED_S = 0.3
"""How long after it was told where it is the robot may report a pose from before."""
_PLACED_OFF = 0.01
"""How much a report may differ then, in m or rad; at rest, any difference is the new place."""
_REST_OFF = 1e-4
_LEVER_M = 0.3
"""At this distance from the robot's centre, turning counts as much as driving."""
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
        """Whether the last report said that the robot moves, and so that the next is near."""
        return bool(self.forward or self.turn)

    def lost(self) -> None:
        """Nobody knows what happens until the next report: it says nothing about driving."""
        self._known = False

    def placed(self, time: float) -> None:
        """Somebody told the robot at `time` where it is: a report after that jumps there."""
        self._placed_until = time + _PLACED_S

    def silent(self) -> None:
        """Nothing was reported for longer than a moving robot is silent."""
        self.sideways = 0.0

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
            speed = aside / max(lasted, 0.02)
            self.sideways = max(-MOST_SPEED_MPS, min(MOST_SPEED_MPS, speed))
        self.forward, self.turn = forward, turn
        self._time, self._map_id = time, map_id
        self._known = True

    def _jumped(
        self, moved: Plane, forward: float, turn: float, lasted: float, time: float
    ) -> bool:
        """Whether the robot cannot have driven as it says it has moved since the last report."""
        ahead, around = (forward + self.forward) / 2, (turn + self.turn) / 2
        # for how long it would have to drive like that; the clock of receipt is only near to it
        by_turn = abs(around) > abs(ahead) / _LEVER_M  # by what is told best
        whole, part = (around, moved.theta) if by_turn else (ahead, moved.x)
        needed = part / whole if whole else 0.0
        driven = _arc(ahead, around, max(0.0, min(needed, lasted + _LATE_S)))
        off = driven.inverse * moved
        if time <= self._placed_until:
            standing = not (forward or turn or self.forward or self.turn)
            limit = _REST_OFF if standing else _PLACED_OFF
            return off.distance > limit or abs(off.theta) > limit
        return abs(off.x) > _OFF_M or abs(off.theta) > _OFF_RAD or abs(off.y) > _ASIDE_M


def _arc(forward: float, turn: float, seconds: float) -> Plane:
    """How far these speeds bring the robot."""
    ahead, turned = forward * seconds, turn * seconds
    return Plane(ahead * math.cos(turned / 2), ahead * math.sin(turned / 2), turned)
