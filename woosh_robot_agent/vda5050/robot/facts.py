"""The last reports of the robot, and the state that follows from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from google.protobuf.message import Message

from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.link import ChassisClient
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
)
from woosh_robot_agent.vda5050.model.state import RobotStatus
from woosh_robot_agent.vda5050.robot import status

_PARTS: tuple[type[Message], ...] = (
    AbnormalCodes,
    Battery,
    DeviceState,
    Mode,
    OperationState,
    RobotState,
    Scene,
    Setting,
)
"""Reports on which the state of the vehicle depends, except its position."""


class RobotFacts:
    """The last reports of the robot. Used in the event loop of the link.

    The state is computed on demand. After a new pose, only position and velocity are updated.

    Args:
        chassis: the link.
        on_moved: called with each report of a pose.
        on_changed: called when another report has arrived.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        on_moved: Callable[[], None],
        on_changed: Callable[[], None],
    ) -> None:
        self._values = LastKnown(chassis)
        self._on_moved = on_moved
        self._on_changed = on_changed
        self._status: RobotStatus | None = None
        self._is_current = False
        """True if `_status` is up to date, except for the position."""
        self._is_moved = False
        """True if the position has changed since `_status` was computed."""
        chassis.on_snapshot(lambda info: self._changed())
        chassis.on_robot_changed(self._forget)
        chassis.subscribe_raw(PoseSpeed, lambda body: self._moved())
        for part in _PARTS:
            chassis.subscribe_raw(part, lambda body: self._changed())
        chassis.subscribe_raw(NavPath, lambda body: self._path_changed())

    @property
    def info(self) -> RobotInfo | None:
        """All reports; None before the first ones."""
        return self._values.value(RobotInfo)

    @property
    def status(self) -> RobotStatus | None:
        """The state of the robot; None before the first reports."""
        info = self.info
        if info is None:
            return None
        if self._status is None or not self._is_current:
            path = status.path(self._values.value(NavPath))
            self._status = replace(status.robot_status(info), path=path)
        elif self._is_moved:
            motion = info.pose_speed.twist
            self._status = replace(
                self._status,
                driving=bool(motion.linear or motion.angular),
                position=status.position(info),
                velocity=status.velocity(info),
            )
        self._is_current, self._is_moved = True, False
        return self._status

    def remember_pose(self, pose: PoseSpeed) -> None:
        """Store a pose that was asked for."""
        self._values.remember(pose)
        self._moved()

    def _moved(self) -> None:
        self._is_moved = True
        self._on_moved()

    def _changed(self) -> None:
        self._is_current = False
        self._on_changed()

    def _path_changed(self) -> None:
        """Invalidate the state. A new path alone does not publish it."""
        self._is_current = False

    def _forget(self) -> None:
        self._status = None
        self._is_current = False
