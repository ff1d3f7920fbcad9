"""The map that the robot is making, from its reports."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from woosh_robot_agent.link import Body, ChassisClient, FrameError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import BuildMapData
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, RobotState
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.standard.subscribers import Subscribers

_MAX_SILENCE = 3.0
"""Time without a report after which a robot in one of `_VAGUE_STATES` makes no map, in seconds.

Robots report the map each second."""
_VAGUE_STATES = (robot.kStateUndefined, robot.kWarning, robot.kFault)
"""States in which the robot may be making a map or not; its reports of the map show it."""


class GrowingMap:
    """The reports of the map that the robot is making, received only while there are subscribers.

    Use it in the link thread.

    Args:
        chassis: the link.
        subscribers: the subscribers of the map.
        on_end: called when the robot no longer makes a map.
    """

    def __init__(
        self, chassis: ChassisClient, subscribers: Subscribers, on_end: Callable[[], None]
    ) -> None:
        self._chassis = chassis
        self._subscribers = subscribers
        self._on_end = on_end
        self._unsubscribe: Callable[[], None] | None = None
        self._state = robot.kStateUndefined
        self._begun = False
        """True from the first sign of a map that is being made until the end."""
        self._body: Body | None = None
        """The latest report, not decoded yet; None if it was taken."""
        self._received = -math.inf
        """Loop time of the latest report; -inf after the end."""
        chassis.on_robot_changed(self._forget)
        chassis.on_snapshot(self._snapshot)
        chassis.subscribe(RobotState, self._state_pushed)

    @property
    def active(self) -> bool:
        """True while the robot is making a map."""
        if self._state == robot.kMapping:
            return True
        return asyncio.get_running_loop().time() - self._received < _MAX_SILENCE

    def subscribe(self) -> None:
        """Receive reports until there are no subscribers; idempotent."""
        if self._unsubscribe is None:
            self._unsubscribe = self._chassis.subscribe_raw(BuildMapData, self._pushed)

    def take(self) -> BuildMapData | None:
        """Return the latest report; None if it cannot be read, or was returned already."""
        body, self._body = self._body, None
        try:
            return None if body is None else body.message()
        except FrameError:  # the link has logged it
            return None

    def _forget(self) -> None:
        self._state = robot.kStateUndefined
        self._begun = False
        self._body = None
        self._received = -math.inf

    def _snapshot(self, info: RobotInfo) -> None:
        self._body = None  # from before the link was lost
        self._set_state(info.state)

    def _state_pushed(self, push: RobotState) -> None:
        self._set_state(push.state)

    def _set_state(self, state: robot.State) -> None:
        self._state = state
        if state == robot.kMapping:
            self._begun = True
        elif state not in _VAGUE_STATES:
            self._body = None
            self._received = -math.inf
            if self._begun:
                self._begun = False
                self._on_end()

    def _pushed(self, body: Body) -> None:
        if not self._subscribers.present:
            if self._unsubscribe is not None:
                self._unsubscribe()
                self._unsubscribe = None
        elif self._state == robot.kMapping or self._state in _VAGUE_STATES:
            self._begun = True
            self._body = body
            self._received = asyncio.get_running_loop().time()
