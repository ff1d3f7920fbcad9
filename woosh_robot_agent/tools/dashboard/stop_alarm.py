"""The alarm of a stop that a robot has not confirmed."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Any

from woosh_robot_agent.motion.gate import StopReport
from woosh_robot_agent.motion.wheel_owner import may_drive
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.pb.util.robot_pb2 import kFollowing
from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.tools.dashboard import part_data
from woosh_robot_agent.tools.dashboard.robot import Robot

_MOVES_ON = Sentence(
    "the robot was stopped and moves, perhaps because another program drives it: stop that "
    "program, or press the emergency stop of the robot"
)()
_SETTLING = 1.5
"""Time after a confirmed stop for which a robot may slow down, in seconds."""
_WATCH = 5.0
"""Time after a confirmed stop until which a moving robot raises the alarm, in seconds."""
_MOVED = 0.05
"""Distance that shows that a robot moves after a confirmed stop, in metres."""
_TURNED = 0.1
"""Angle that shows that a robot turns after a confirmed stop, in radians."""
_STANDSTILL = 1.0
"""Time for which a robot must stand still to end its alarm, in seconds."""
_SAME_PLACE = 0.01
"""Maximum distance between two poses of a robot that stands still, in metres. The speed does not
tell, because robots report none while they move sideways."""


class StopAlarm:
    """Remembers that a stop was not confirmed, or that the robot moves after a confirmed one.

    The alarm ends with a later stop that is confirmed, or when the robot stands still. A robot may
    move after a confirmed stop because another program, e.g. an agent with a joystick, goes on
    sending velocities.

    A robot does not stand still while it executes an action, e.g. moves a lift, or a task that may
    drive on by itself, or follows somebody. An action that was executing when the link was lost
    counts as executing until the robot reports its state, or a stop succeeds.

    `on_answered` is called after each answer to a stop.
    """

    def __init__(self, robot: Robot, on_answered: Callable[[], None]) -> None:
        self._robot = robot
        self._on_answered = on_answered
        self._reason = ""
        """Why the robot may move after a stop; empty without an alarm."""
        self._given = -math.inf
        """Loop time at which the last answered stop was given."""
        self._maybe_moving_at = -math.inf
        """Loop time of the last check that could not rule out motion; -inf before the first."""
        self._received = 0
        """Number of frames received until `_maybe_moving_at`; only a later frame can show a
        standstill."""
        self._pose: dict[str, Any] | None = None
        """Pose of the robot at `_maybe_moving_at`, as in the part `pose`."""
        self._confirmed_at = -math.inf
        """Loop time of the last confirmed stop; -inf before the first, and after a command."""
        self._stopped_pose: dict[str, Any] | None = None
        """Pose at which the robot stood after that; None until it is known."""
        robot.chassis.subscribe(PoseSpeed, lambda report: self._moved())

    @property
    def reason(self) -> str:
        """Why the robot may move after a stop; empty without an alarm.

        Reading it ends the alarm if the robot has been seen to stand still for long enough.
        """
        self._check_standstill()
        return self._reason

    def answered(self, report: StopReport, given: float) -> None:
        """Raise the alarm if a stop was not confirmed, otherwise end it.

        `given` is the loop time at which the stop was given. If a later stop is answered already,
        the alarm does not change.
        """
        if given >= self._given:
            self._given = given
            self._reason = "" if report.success else report.message
            self._confirmed_at, self._stopped_pose = -math.inf, None
            if report.success:  # no action goes on
                self._confirmed_at = asyncio.get_running_loop().time()
                self._robot.lost_actions.clear()
            self._restart_standstill()
        self._on_answered()

    def motion_commanded(self) -> None:
        """Note that a viewer has commanded a motion after the last stop."""
        self._confirmed_at = -math.inf

    def _moved(self) -> None:
        """Raise the alarm if the robot moves after a confirmed stop; end it at a standstill."""
        since = asyncio.get_running_loop().time() - self._confirmed_at
        pose = part_data.pose_data(self._robot.view.info)
        if not self._reason and pose is not None and _SETTLING < since < _WATCH:
            former = self._stopped_pose = self._stopped_pose or pose
            turned = math.remainder(pose["theta"] - former["theta"], math.tau)
            if _distance(former, pose) > _MOVED or abs(turned) > _TURNED:
                self._reason, self._stopped_pose = _MOVES_ON, pose
                self._restart_standstill()
                self._on_answered()
        self._check_standstill()

    def _restart_standstill(self) -> None:
        """Begin the time for which the robot must stand still: now, and at its present pose."""
        self._maybe_moving_at = asyncio.get_running_loop().time()
        self._received = self._robot.chassis.stats.rx
        self._pose = part_data.pose_data(self._robot.view.info)

    def _check_standstill(self) -> None:
        """End the alarm if the robot has been seen to stand still for long enough."""
        if not self._reason:
            return
        chassis, now = self._robot.chassis, asyncio.get_running_loop().time()
        if self._may_move() or not self._robot.is_live:
            self._restart_standstill()
        elif now - self._maybe_moving_at > _STANDSTILL and chassis.stats.rx > self._received:
            self._reason = ""

    def _may_move(self) -> bool:
        """Return False only if the robot reports no speed, the same pose, and nothing that goes on.

        The pose is compared with that at `_maybe_moving_at`.
        """
        view, former = self._robot.view, self._pose
        if may_drive(view.info.task_proc) or view.info.state == kFollowing:
            return True
        if self._robot.executing or self._robot.lost_actions:
            return True
        pose = part_data.pose_data(view.info)
        if pose is None or former is None or pose["linear"] or pose["angular"]:
            return True
        return _distance(pose, former) > _SAME_PLACE


def _distance(pose: dict[str, Any], other: dict[str, Any]) -> float:
    """Return the distance between two poses, in metres."""
    return math.dist((pose["x"], pose["y"]), (other["x"], other["y"]))
