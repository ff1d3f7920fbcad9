"""Limit of the speed at which the robot navigates."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Collection, Coroutine
from typing import Any

from woosh_robot_agent.link import ChassisClient, LinkError, LinkState, NotConnectedError
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.motion.gate import AnsweredCommand, MotionGate
from woosh_robot_agent.motion.wheel_owner import is_unfinished
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ChangeNavMode
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.pb.ros.action_pb2 import MoveBase, NavigationMode, kExecute
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import navigation_pb2 as navigation
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.sentences import Sentence

_LOG = logging.getLogger(__name__)
_LIMIT_REFUSED = Sentence("the robot refused the speed limit of {limit} m/s: {reason}")
_UNKNOWN = math.nan
"""Stands for an unknown limit: NaN differs from each limit, so the next one is sent."""
_RETRY_AFTER = 1.0
"""Time after which a limit that was not sent or not answered is sent again, in seconds."""
_MOVE_BASE = MoveBase.DESCRIPTOR.name
_ACTION = -1
"""Value of `_navigation` while the action MoveBase navigates; otherwise it is the id of a task."""


class SpeedLimiter:
    """Limits the speed of the robot's navigation. Used in the event loop of the link.

    The robot takes a limit only while it navigates, in a task or in the action MoveBase, so a limit
    is sent once the robot reports a navigation. Whether it keeps the limit for the next navigation
    is not known, so the limit is sent again for each one.

    Args:
        chassis: the link.
        gate: sends the limits.
        start: runs a coroutine that sends a limit as a task, which the caller may cancel.
        on_refused: called with the reason if the robot does not take a limit.
        on_change: called when `is_limited` changes, before the robot gets the limit.

    Attributes:
        refusal: the robot's text if it refused the limit in this navigation; otherwise empty.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        start: Callable[[Coroutine[Any, Any, None]], object],
        on_refused: Callable[[str], None],
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        self._chassis = chassis
        self._gate = gate
        self._start = start
        self._on_refused = on_refused
        self._on_change = on_change
        self._limit: float | None = None
        """Current limit, in m/s; infinite without a limit, None while there is nothing to limit."""
        self._sent = math.inf
        """Limit that was sent last; infinite before the first, `_UNKNOWN` if the robot may not have
        it."""
        self.refusal = ""
        self._retry: asyncio.TimerHandle | None = None
        """Timer that sends the limit again; None before the first."""
        self._log = LogOnce(_LOG)
        self._task_id = 0
        """Id of the task that the robot executes."""
        self._task_navigates = False
        self._action_navigates = False
        """True if the action MoveBase navigates, as far as is known."""
        gate.wheel_owner.on_task(self._task_reported)
        gate.wheel_owner.on_action(self._action_reported)
        gate.wheel_owner.on_known(self._owner_known)
        chassis.on_state(self._link_changed)
        gate.on_answered(self._answered)

    @property
    def is_limited(self) -> bool:
        """True if the robot has a limit of this limiter, or may have one."""
        return self._sent != math.inf

    def restore(self, is_limited: bool) -> None:
        """Restore the last value of the property `is_limited` of an earlier process."""
        self._sent = _UNKNOWN if is_limited else math.inf

    def limit(self, limit: float | None) -> None:
        """Set the speed limit.

        Args:
            limit: maximum speed, in m/s; infinite to end an earlier limit; None while there is
                nothing to limit, to send nothing.
        """
        if limit != self._limit:
            self._limit, self.refusal = limit, ""
        self._send()

    @property
    def _navigation(self) -> int:
        """Id of the task that navigates, or `_ACTION`; 0 while the robot does not navigate."""
        if self._task_navigates:
            return self._task_id
        return _ACTION if self._action_navigates else 0

    def _link_changed(self, state: LinkState) -> None:
        """Send the limit once the link is ready; without a link, no navigation is known."""
        if state is LinkState.READY:
            self._send()  # when the first RobotInfo came, no request was possible yet
        else:
            self._task_navigates = self._action_navigates = False

    def _owner_known(self, unknown: Collection[str]) -> None:
        """Assume that the action still navigates, if the robot does not tell in a new link."""
        if _MOVE_BASE in unknown:
            self._action_reported(_MOVE_BASE, goes_on=True)

    def _task_reported(self, report: TaskProc) -> None:
        """Note whether the task navigates, and send the limit if needed."""
        # a task that has ended may begin again with the same id
        if report.robot_task_id != self._task_id or not is_unfinished(report):
            self._task_id = report.robot_task_id
            self._begin()
        self._task_navigates = (
            report.state == task.kExecuting
            and report.action.type == action.kNav
            and report.action.state == action.kRosExecuting
        )
        self._send()

    def _action_reported(self, name: str, goes_on: bool) -> None:
        """Note whether the action MoveBase navigates, and send the limit if needed."""
        if name == _MOVE_BASE:
            if goes_on != self._action_navigates:
                self._begin()
            self._action_navigates = goes_on
            self._send()

    def _answered(self, command: AnsweredCommand) -> None:
        """Note that a command of MoveBase may begin a navigation, and send the limit if needed.

        Send the limit also if a client has just set a higher one, or none.
        """
        message = command.message
        if isinstance(message, CallAction) and message.move_base.action == kExecute:
            self._begin()  # it may replace another navigation, whose end is not reported then
            self._send()
        elif command.answer.ok and self._is_faster(message):
            self._begin()
            self._send()

    def _is_faster(self, message: Any) -> bool:
        """Return True if a command of a client has set a higher limit, or none."""
        if self._limit is None or self._limit == math.inf:
            return False
        is_action = isinstance(message, CallAction) and message.HasField("nav_mode")
        if not (is_action or isinstance(message, ChangeNavMode)):
            return False
        # both limits as in a request, whose numbers have 32 bits
        request: Any = _limit_request(self._limit, in_action=is_action)
        limit, sent = request.nav_mode.max_speed, message.nav_mode.max_speed
        return limit > 0.0 and not 0.0 < sent <= limit

    def _begin(self) -> None:
        """Note that a navigation begins: a limit that was sent before must be sent again."""
        self.refusal = ""
        if self._sent != math.inf:
            self._sent = _UNKNOWN

    def _send(self) -> None:
        """Send the limit if the robot navigates, may not have it yet and has not refused it."""
        if self._limit is None or self._limit == self._sent:  # nothing to limit, or sent already
            return
        if self.refusal or not self._navigation:
            return
        self._note_sent(self._limit)
        self._start(self._send_limit(self._navigation, self._limit))

    def _note_sent(self, limit: float) -> None:
        """Note the limit that the robot gets, or `_UNKNOWN`."""
        was_limited, self._sent = self.is_limited, limit
        if self.is_limited != was_limited:
            self._on_change()

    async def _send_limit(self, navigation: int, limit: float) -> None:
        """Send a limit.

        A refusal ends the attempts for this navigation, unless the robot navigates to something
        else by then, or the limit has changed.

        Args:
            navigation: the navigation to limit: the value of `_navigation` before the request.
            limit: maximum speed, in m/s; infinite without a limit.
        """
        try:
            answer = await self._gate.request(
                _limit_request(limit, in_action=navigation == _ACTION)
            )
        except LinkError as error:
            if not isinstance(error, NotConnectedError):  # the link logs this itself
                text = f"the speed limit was not sent or not answered: {error}"
                self._log.warn(type(error).__name__, text)
            self._note_sent(_UNKNOWN)
            # by a timer, because a robot that just goes on driving reports nothing more
            if self._retry is not None:
                self._retry.cancel()
            self._retry = asyncio.get_running_loop().call_later(_RETRY_AFTER, self._send)
            return
        self._log.clear()
        if answer.ok:
            return
        self._note_sent(_UNKNOWN)
        is_outdated = limit != self._limit or navigation != self._navigation
        if is_outdated:
            return
        self.refusal = answer.reason
        if math.isfinite(limit):  # otherwise the robot is at most slower than it may be
            self._on_refused(_LIMIT_REFUSED(limit=str(limit), reason=self.refusal))


def _limit_request(limit: float, *, in_action: bool) -> CallAction | ChangeNavMode:
    """Return the request that sets a limit.

    There is no request for the speed alone: it also sets accurate arrival and obstacle avoidance.

    Args:
        limit: maximum speed, in m/s; infinite to remove the limit.
        in_action: True if the action MoveBase navigates, False if a task does.
    """
    speed = limit if math.isfinite(limit) else 0.0  # 0: the robot's own maximum
    if in_action:
        mode = NavigationMode(mode=NavigationMode.kAccurateAvoid, max_speed=speed)
        return CallAction(nav_mode=mode)
    setting = navigation.ModeSetting(
        type=navigation.kAccurate, mode=navigation.kAvoid, max_speed=speed
    )
    return ChangeNavMode(nav_mode=setting)
