"""The last reports of the robot, and the status computed from these reports."""

from __future__ import annotations

import asyncio
import logging
import math
from dataclasses import replace

from google.protobuf.message import Message

from woosh_robot_agent.link import Answer, LinkError
from woosh_robot_agent.motion.wheel_owner import is_unfinished
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes
from woosh_robot_agent.pb.robot.robot_pb2 import (
    Battery,
    DeviceState,
    Mode,
    NavPath,
    OperationState,
    PoseSpeed,
    RobotInfo,
    RobotState,
    Scene,
    Setting,
    TaskProc,
)
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.robot.who_drives import REPORT_GAP
from woosh_robot_agent.vda5050.messages.state import OperatingMode, Position, RobotStatus
from woosh_robot_agent.vda5050.robot import status
from woosh_robot_agent.vda5050.robot.link import RobotLink

_LOG = logging.getLogger(__name__)
_STATUS_REPORTS: tuple[type[Message], ...] = (
    AbnormalCodes,
    Battery,
    DeviceState,
    Mode,
    OperationState,
    RobotState,
    Scene,
    Setting,
    TaskProc,
)
"""Reports from which the status is computed; its position comes from PoseSpeed."""


class ReportedState:
    """The last reports of the robot, and its status. Used in the event loop of the link.

    The status is computed on demand. After a new pose, only what depends on it is updated.
    """

    def __init__(self, link: RobotLink) -> None:
        self._link = link
        self._values = LastKnown(link.chassis)
        self._status: RobotStatus | None = None
        """The status when it was read last; None if it has changed since, except for its pose."""
        self._has_moved = False
        """True if the position has changed since `_status` was computed."""
        self._pose_at = -math.inf
        """Loop time of the last report of a pose, or of the last request for one."""
        self._silence_timer: asyncio.TimerHandle | None = None
        """Asks a moving robot for its pose if no report comes; None while the robot stands."""
        # the reports themselves are stored by `_values`
        link.chassis.on_snapshot(lambda info: self._changed())
        link.chassis.subscribe_raw(PoseSpeed, lambda body: self._moved())
        for report in _STATUS_REPORTS:
            link.chassis.subscribe_raw(report, lambda body: self._changed())
        link.chassis.subscribe_raw(NavPath, lambda body: self._path_changed())
        link.gate.wheel_owner.on_task(self._task_told)

    @property
    def info(self) -> RobotInfo | None:
        """The last reports of the robot; None before the first RobotInfo."""
        return self._values.value(RobotInfo)

    @property
    def status(self) -> RobotStatus | None:
        """Status of the robot, without its maps; None before the first RobotInfo."""
        info = self.info
        if info is None:
            return None
        if self._status is None:
            report = self._values.value(NavPath)
            path = () if report is None else status.points(report.path.poses)
            self._status = replace(status.robot_status(info), path=path)
        elif self._has_moved:
            self._status = replace(
                self._status,
                driving=status.drives(info),
                position=status.position(info),
                velocity=status.velocity(info),
            )
        self._has_moved = False
        return self._status

    @property
    def position(self) -> Position | None:
        """The position of the robot; None if it is on no map, or unknown."""
        return None if self.status is None else self.status.position

    @property
    def is_automatic(self) -> bool:
        return self.status is not None and self.status.mode is OperatingMode.AUTOMATIC

    @property
    def is_charging(self) -> bool:
        return self.status is not None and self.status.battery.charging

    @property
    def is_driving(self) -> bool:
        """True while the robot moves, by its last report."""
        return self.status is not None and self.status.driving

    async def read_pose(self) -> None:
        """Ask for the pose, and store it: a robot that stands pushes it late, or not at all.

        Raises:
            LinkError: the robot did not answer.
        """

        def take_answer(answer: Answer) -> None:
            if answer.ok and isinstance(answer.body, PoseSpeed):
                self._values.remember(answer.body)
                self._moved()

        await self._link.ask(PoseSpeed(), tap=take_answer)

    def _moved(self) -> None:
        """Take note of a new pose."""
        self._pose_at = asyncio.get_running_loop().time()
        self._has_moved = True
        self._link.moved()
        self._watch_for_silence()

    def _changed(self) -> None:
        self._status = None
        self._link.changed()
        self._watch_for_silence()

    def _task_told(self, report: TaskProc) -> None:
        """Forget a task whose end is known from an answer: `_values` stores pushed reports only."""
        info = self.info
        has_ended = not report.robot_task_id
        if has_ended and info is not None and is_unfinished(info.task_proc):
            self._values.remember(report)
            self._changed()

    def _watch_for_silence(self) -> None:
        """Start the timer for the next pose if the robot moves: a standing robot reports none."""
        if self._silence_timer is None and self.is_driving and not self._link.is_closing:
            loop = asyncio.get_running_loop()
            due = max(loop.time(), self._pose_at + REPORT_GAP)
            self._silence_timer = loop.call_at(due, self._check_silence)

    def _check_silence(self) -> None:
        """Ask for the pose if none was reported: the report of the standstill may be lost."""
        self._silence_timer = None
        now = asyncio.get_running_loop().time()
        if now >= self._pose_at + REPORT_GAP and self.is_driving and not self._link.is_closing:
            self._pose_at = now  # wait a full period before asking again
            if self._link.ready:
                self._link.background.start_once(self._ask_for_pose, self)
        self._watch_for_silence()

    async def _ask_for_pose(self) -> None:
        """Ask for the pose once; without an answer, `_check_silence` asks again."""
        try:
            await self.read_pose()
        except LinkError as error:
            _LOG.debug("no answer about the pose: %s", error)  # asked again

    def _path_changed(self) -> None:
        self._status = None  # without `_link.changed`: a new path needs no state message
