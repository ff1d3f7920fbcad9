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
from woosh_robot_agent.tools.dashboard import part_data
from woosh_robot_agent.tools.dashboard.robot import Robot

_STANDSTILL = 1.0
"""Time for which a robot must stand still to end its alarm, in seconds."""
_SAME_PLACE = 0.01
"""Maximum distance between two poses of a robot that stands still, in metres. The speed does not
tell, because robots report none while they move sideways."""


class StopAlarm:
    """Remembers that a stop was not confirmed, until a later stop is, or the robot stands still.

    A robot does not stand still while it executes an action, e.g. moves a lift, or a task that may
    drive on by itself, or follows somebody. An action that was executing when the link was lost
    counts as executing until the robot reports its state, or a stop succeeds.

    `on_answered` is called after each answer to a stop.
    """

    def __init__(self, robot: Robot, on_answered: Callable[[], None]) -> None:
        self._robot = robot
        self._on_answered = on_answered
        self._reason = ""
        """Why the stop was not confirmed; empty without an alarm."""
        self._given = -math.inf
        """Loop time at which the last answered stop was given."""
        self._maybe_moving_at = -math.inf
        """Loop time of the last check that could not rule out motion; -inf before the first."""
        self._received = 0
        """Number of frames received until `_maybe_moving_at`; only a later frame can show a
        standstill."""
        self._pose: dict[str, Any] | None = None
        """Pose of the robot at `_maybe_moving_at`, as in the part `pose`."""
        robot.chassis.subscribe(PoseSpeed, lambda report: self._check_standstill())

    @property
    def reason(self) -> str:
        """Why the stop was not confirmed; empty without an alarm.

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
            if report.success:  # no action goes on
                self._robot.lost_actions.clear()
            self._restart_standstill()
        self._on_answered()

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
        return math.dist(*((each["x"], each["y"]) for each in (pose, former))) > _SAME_PLACE
