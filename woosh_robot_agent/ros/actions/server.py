"""An action server whose goals live in the link thread.

rclpy's own server runs a callback in the executor from the start of a goal to its end, and does not
tell when a client sent a goal. Therefore this server uses the three services and two topics that an
action consists of. The executor thread only hands requests over; the link thread keeps the goals
and replies.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Coroutine
from functools import partial
from typing import Any

from action_msgs.msg import GoalInfo, GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.qos import QoSProfile

from woosh_robot_agent.link.tasks import start_task
from woosh_robot_agent.motion.timeliness import SenderClock
from woosh_robot_agent.ros.actions.goal import Outcome
from woosh_robot_agent.ros.bridge import DeferredService, LinkThread, Reply
from woosh_robot_agent.ros.qos import FEEDBACK_QOS, SERVICE_QOS, latched
from woosh_robot_agent.ros.rclpy_private import PEER_GONE_ERRORS, undelivered_responses
from woosh_robot_agent.ros.subscribers import create_publisher

_LOG = logging.getLogger(__name__)
_ACTIVE = (GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)
"""States of a goal that has not ended. In both, a client can cancel it: the chassis may have
refused an earlier cancel."""
_MAX_RESULTS = 100
"""Maximum number of ended goals that are kept. Each status message, two for a goal, lists them
all."""


class Goal:
    """A goal of an action server. Use it in the link thread.

    Args:
        info: id, and time of the arrival.
        request: the goal as the client gave it.
        published: loop time at which the client sent it, as far as that is known.

    Attributes:
        objection: why the goal cannot be executed, if the server accepts it in spite of that; empty
            if it can be executed.
        status: state of the goal, a constant of action_msgs/GoalStatus.
    """

    def __init__(
        self,
        server: GoalServer,
        info: GoalInfo,
        request: Any,
        published: float,
    ) -> None:
        self.info = info
        self.request = request
        self.published = published
        self.objection = ""
        self.status = GoalStatus.STATUS_EXECUTING
        self._server = server
        self._result: Any = None
        """Response to clients that request the result; None until the goal has ended."""
        self._waiting: list[Reply] = []
        """Clients that wait for the result."""
        self._on_cancel: Callable[[], None] | None = None

    @property
    def is_active(self) -> bool:
        """True until `finish` is called."""
        return self.status in _ACTIVE

    def on_cancel(self, callback: Callable[[], None]) -> None:
        """Call `callback` whenever a client asks to cancel the goal; at once if one already has."""
        self._on_cancel = callback
        if self.status == GoalStatus.STATUS_CANCELING:
            callback()

    def note_cancel_request(self) -> None:
        """Note that a client asks to cancel the goal."""
        self.status = GoalStatus.STATUS_CANCELING
        if self._on_cancel is not None:
            self._on_cancel()

    def feedback(self, feedback: Any) -> None:
        """Publish a message of the action's type Feedback; does nothing once the goal has ended."""
        if self.is_active:
            self._server.publish_feedback(self.info, feedback)

    def finish(self, outcome: Outcome, result: Any) -> None:
        """End the goal; only the first call has an effect.

        Args:
            outcome: final state. `CANCELED` without a client that asked for it becomes `ABORTED`.
            result: message of the action's type Result.
        """
        if not self.is_active:
            return
        if outcome is Outcome.SUCCEEDED:
            self.status = GoalStatus.STATUS_SUCCEEDED
        elif outcome is Outcome.CANCELED and self.status == GoalStatus.STATUS_CANCELING:
            self.status = GoalStatus.STATUS_CANCELED
        else:
            self.status = GoalStatus.STATUS_ABORTED
        self._result = self._server.action_type.Impl.GetResultService.Response(
            status=self.status, result=result
        )
        self._server.goal_ended(self)
        for reply in self._waiting:
            reply.send(self._result)
        self._waiting.clear()

    def send_result(self, reply: Reply) -> None:
        """Send the result to a client, as soon as there is a result."""
        if self._result is None:
            self._waiting.append(reply)
        else:
            reply.send(self._result)


class RejectedError(Exception):
    """A goal cannot be executed. The text is the reason."""


async def _accept(_request: Any) -> None:
    """Accept every goal."""


class GoalServer:
    """Server of one action. It accepts every request to cancel.

    Args:
        start: called with each accepted goal in the link thread; must not block.
        result_timeout: time for which the result of a goal is kept, in seconds.
        check: called with each goal before it is accepted; may change the goal, and raises a
            RejectedError to reject it. By default, every goal is accepted.
        rejects: False to accept what `check` rejects, too, with the reason as its `objection`,
            because a rejection cannot carry a text. `start` then ends the goal with that text.
    """

    def __init__(
        self,
        node: Any,
        thread: LinkThread,
        action_type: Any,
        name: str,
        start: Callable[[Goal], None],
        result_timeout: float,
        check: Callable[[Any], Awaitable[None]] = _accept,
        *,
        rejects: bool = True,
        services: QoSProfile = SERVICE_QOS,
        feedback: QoSProfile = FEEDBACK_QOS,
    ) -> None:
        self.action_type = action_type
        self._name = name
        self._node = node
        self._start = start
        self._check = check
        self._rejects = rejects
        self._checking = asyncio.Lock()
        """Held until a goal is checked, so that goals are accepted in the order of arrival."""
        self._result_timeout = result_timeout
        self._unchecked: dict[bytes, Goal] = {}
        """Goals that are not accepted yet, by the bytes of their ids. A client may cancel them."""
        self._goals: dict[bytes, Goal] = {}
        """Goals that are active or whose results are kept, by the bytes of their ids."""
        self._ended: dict[bytes, asyncio.TimerHandle] = {}
        """Timers that forget the goals whose results are kept, the oldest first."""
        self._clock = SenderClock()
        parts = action_type.Impl
        for srv_type, verb, serve in (
            (parts.SendGoalService, "send_goal", self._goal_sent),
            (CancelGoal, "cancel_goal", self._cancel_requested),
            (parts.GetResultService, "get_result", self._result_requested),
        ):
            DeferredService(
                node,
                srv_type,
                f"{name}/_action/{verb}",
                partial(_hand_over, thread, serve),
                qos=services,
            )
        self._feedback = create_publisher(
            node, parts.FeedbackMessage, f"{name}/_action/feedback", feedback
        )
        self._status = create_publisher(
            node, parts.GoalStatusMessage, f"{name}/_action/status", latched(1)
        )

    @property
    def open_goals(self) -> int:
        """Number of goals that have not ended."""
        return sum(goal.is_active for goal in tuple(self._goals.values()))

    @property
    def has_clients(self) -> bool:
        """True if anything receives feedback: each client of rclpy and rclcpp does."""
        return bool(self._feedback.get_subscription_count())

    def publish_feedback(self, info: GoalInfo, feedback: Any) -> None:
        """Publish feedback on a goal."""
        message = self.action_type.Impl.FeedbackMessage(goal_id=info.goal_id, feedback=feedback)
        self._publish(self._feedback, message)

    def goal_ended(self, goal: Goal) -> None:
        """Publish the final state of a goal, and forget the goal after `result_timeout`.

        It is forgotten earlier if too many other goals end meanwhile.
        """
        self._publish_status()
        key, loop = _key(goal.info), asyncio.get_running_loop()
        self._ended[key] = loop.call_later(self._result_timeout, self._forget, key)
        if len(self._ended) > _MAX_RESULTS:
            self._forget(next(iter(self._ended)))

    def _forget(self, key: bytes) -> None:
        self._ended.pop(key).cancel()
        del self._goals[key]

    async def _goal_sent(self, request: Any, reply: Reply, taken: float) -> None:
        """Check a goal, tell its client if it is accepted, and start it.

        `taken` is the monotonic time at which the executor took the request.
        """
        response = self.action_type.Impl.SendGoalService.Response()
        response.stamp = self._node.get_clock().now().to_msg()
        info = GoalInfo(goal_id=request.goal_id, stamp=response.stamp)
        key, published = _key(info), self._clock.published(*reply.times, taken)
        if key in self._goals or key in self._unchecked:  # the id is in use: reject the goal
            reply.send(response)
            return
        self._unchecked[key] = goal = Goal(self, info, request.goal, published)
        # begun before the lock is free: several checks may wait at the same time, e.g. for /tf
        check = start_task(self._find_objection(request.goal), name=f"check: {self._name}")
        try:
            async with self._checking:
                goal.objection = await check
        finally:
            check.cancel()
            del self._unchecked[key]
        if goal.objection and self._rejects:
            _LOG.warning("%s: a goal is rejected: %s", self._name, goal.objection)
            reply.send(response)
            return
        response.accepted = True
        with undelivered_responses() as undelivered:
            is_sent = reply.send(response)
        if undelivered or not is_sent:
            _LOG.warning(
                "%s: a goal is not executed, because its client cannot be told that it is "
                "accepted: the client has gone, or this agent has not discovered it yet; send the "
                "goal again",
                self._name,
            )
            return
        self._goals[key] = goal
        self._publish_status()
        self._start(goal)

    async def _find_objection(self, request: Any) -> str:
        """Return why a goal cannot be executed; empty if it can."""
        try:
            await self._check(request)
        except RejectedError as error:
            return str(error)
        return ""

    async def _cancel_requested(self, request: Any, reply: Reply, _taken: float) -> None:
        response = CancelGoal.Response()
        for goal in self._selected(request.goal_info):
            if goal.is_active:
                goal.note_cancel_request()
                response.goals_canceling.append(goal.info)
        names_a_goal = any(request.goal_info.goal_id.uuid)  # otherwise it selects by time, or all
        if names_a_goal and not response.goals_canceling:
            is_known = _key(request.goal_info) in self._goals
            response.return_code = (
                CancelGoal.Response.ERROR_GOAL_TERMINATED
                if is_known
                else CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID
            )
        reply.send(response)
        self._publish_status()

    def _selected(self, info: GoalInfo) -> list[Goal]:
        """Return the goals that a cancel selects by the rules of action_msgs/srv/CancelGoal.

        A goal whose stamp is later than now was accepted before the clock was set back. A cancel by
        time selects it, because nobody knows when that was.
        """
        goal_id = _key(info)
        accepted_until, now = _nanoseconds(info), self._node.get_clock().now().nanoseconds
        goals = {**self._goals, **self._unchecked}
        if not any(goal_id) and not accepted_until:
            return list(goals.values())

        def has_selected_time(goal: Goal) -> bool:
            stamp = _nanoseconds(goal.info)
            # 0 means no time, though it is also the stamp of a goal before simulated time starts
            return accepted_until > 0 and (stamp <= accepted_until or stamp > now)

        return [goal for key, goal in goals.items() if key == goal_id or has_selected_time(goal)]

    async def _result_requested(self, request: Any, reply: Reply, _taken: float) -> None:
        goal = self._goals.get(bytes(request.goal_id.uuid))
        if goal is None:  # a blank response has the status STATUS_UNKNOWN
            reply.send(self.action_type.Impl.GetResultService.Response())
        else:
            goal.send_result(reply)

    def _publish_status(self) -> None:
        message = self.action_type.Impl.GoalStatusMessage()
        message.status_list = [
            GoalStatus(goal_info=goal.info, status=goal.status) for goal in self._goals.values()
        ]
        self._publish(self._status, message)

    @staticmethod
    def _publish(publisher: Any, message: Any) -> None:
        try:
            publisher.publish(message)
        except PEER_GONE_ERRORS as error:
            _LOG.debug("cannot publish on a goal: %s", error)


def _hand_over(
    thread: LinkThread,
    serve: Callable[[Any, Reply, float], Coroutine[Any, Any, None]],
    request: Any,
    reply: Reply,
) -> None:
    """Let the link thread serve a request; `serve` also gets the monotonic time of this call."""
    thread.spawn(partial(serve, request, reply, time.monotonic()), reply.fail)


def _key(info: GoalInfo) -> bytes:
    return bytes(info.goal_id.uuid)


def _nanoseconds(info: GoalInfo) -> int:
    return int(info.stamp.sec) * 1_000_000_000 + int(info.stamp.nanosec)
