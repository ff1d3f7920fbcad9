"""The speed limit of the task that drives a leg."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

from woosh_robot_agent.link import LinkError, NotConnectedError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ChangeNavMode
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, TaskProc
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import navigation_pb2 as navigation
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.vda5050.robot.link import RobotLink

_LOG = logging.getLogger(__name__)
_UNKNOWN = math.nan
"""Stands for an unknown limit: NaN differs from each limit, so the next one is sent."""


class SpeedLimiter:
    """Limits the speed of the robot's navigation. Used in the event loop of the link.

    The robot takes a limit only while it navigates, so a limit is sent once it reports that.

    Args:
        on_refused: called with the reason if the robot does not take a limit.
    """

    def __init__(self, link: RobotLink, on_refused: Callable[[str], None]) -> None:
        self._link = link
        self._on_refused = on_refused
        self._limit: float | None = None
        """Limit of the leg; infinite without one, None while no leg is driven."""
        self._sent = math.inf
        """Limit that was sent last."""
        self._refused: float | None = None
        """Limit that the robot has refused in this task."""
        self._task_id = 0
        """Id of the task that the robot executes."""
        self._navigates = False
        link.chassis.subscribe(TaskProc, self._reported)
        link.chassis.on_snapshot(self._connected)

    @property
    def is_limited(self) -> bool:
        """True if the robot has a limit from here, or may have one."""
        return self._sent != math.inf

    def restore(self, is_limited: bool) -> None:
        """Take what was remembered over a restart.

        Args:
            is_limited: the robot may have a limit.
        """
        self._sent = _UNKNOWN if is_limited else math.inf

    def limit(self, limit: float | None) -> None:
        """Set the speed limit.

        Args:
            limit: maximum speed, in m/s; infinite without a limit, None while no leg is driven.
        """
        self._limit = limit
        self._send()

    def _connected(self, info: RobotInfo) -> None:
        self._reported(info.task_proc)

    def _reported(self, report: TaskProc) -> None:
        if report.robot_task_id != self._task_id:
            self._task_id = report.robot_task_id
            self._refused = None
            if self._sent != math.inf:
                self._sent = _UNKNOWN  # it is unknown whether the robot keeps a limit
        self._navigates = (
            report.state == task.kExecuting
            and report.action.type == action.kNav
            and report.action.state == action.kRosExecuting
        )
        self._send()

    def _send(self) -> None:
        if self._limit is None or not self._navigates:
            return
        if self._limit in (self._sent, self._refused):
            return
        was_limited, self._sent = self.is_limited, self._limit
        self._link.work.start(self._request(self._task_id, self._limit))
        if self.is_limited != was_limited:
            self._link.changed()  # saves it before the robot gets the limit

    async def _request(self, task_id: int, limit: float) -> None:
        mode = navigation.ModeSetting(
            type=navigation.kAccurate,
            mode=navigation.kAvoid,
            max_speed=limit if math.isfinite(limit) else 0.0,
        )
        try:
            answer = await self._link.command(ChangeNavMode(nav_mode=mode))
        except LinkError as error:
            if not isinstance(error, NotConnectedError):  # the link says so itself
                _LOG.warning("the speed limit was not sent or not answered: %s", error)
            self._sent = _UNKNOWN  # sent again with the next report
            return
        if answer.ok or task_id != self._task_id or not self._navigates:
            return
        self._sent = _UNKNOWN
        self._refused = limit
        if math.isfinite(limit):
            self._on_refused(f"the robot refused the speed limit of {limit} m/s: {answer.msg}")
