"""The ROS side of the actions: an action server whose goals are run by the link's thread."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import Any

from rclpy.action import CancelResponse, GoalResponse

from woosh_robot_agent.logs import log_as
from woosh_robot_agent.qos import SERVICE_QOS
from woosh_robot_agent.rclpy_private import PEER_GONE_ERRORS, DeferringActionServer, RCLError

_LOG = logging.getLogger(__name__)
_ANY_GOAL = bytes(16)


class Outcome(Enum):
    """How a goal ends."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


class Goal:
    """One accepted goal, for the link's thread to report on.

    Args:
        server: the server that accepted it.
        handle: rclpy's handle of it.
    """

    def __init__(self, server: GoalServer, handle: Any) -> None:
        self._server = server
        self._handle = handle
        self._lock = threading.Lock()
        self._finished = False
        self.arg: Any = handle.request.arg
        """The command, as the client gave it."""
        self._cancel_asked = False
        self._on_cancel: Callable[[], None] | None = None

    def on_cancel(self, callback: Callable[[], None]) -> None:
        """Have `callback` called when a client asks to cancel the goal, or now if one has."""
        with self._lock:
            self._on_cancel = callback
            asked = self._cancel_asked
        if asked:
            callback()

    def ask_to_cancel(self) -> None:
        """A client asks to cancel the goal; in the executor's thread."""
        with self._lock:
            self._cancel_asked = True
            callback = self._on_cancel
        if callback is not None:
            callback()

    @property
    def canceling(self) -> bool:
        """Whether a client asked before, and the goal goes on nevertheless."""
        return bool(self._handle.is_cancel_requested)

    def feedback(self, fb: Any) -> None:
        """Publish a report; ignored once the goal has ended."""
        with self._lock:
            if self._finished:
                return
            try:
                self._handle.publish_feedback(self._server.action_type.Feedback(fb=fb))
            except PEER_GONE_ERRORS as error:
                _LOG.debug("cannot publish feedback: %s", error)

    def finish(self, outcome: Outcome, ret: Any) -> None:
        """End the goal; only the first call counts."""
        with self._lock:
            if self._finished:
                return
            self._finished = True
        self._server.finish(self._handle, outcome, ret)


class GoalServer(DeferringActionServer):
    """Accepts every goal and every cancel, and leaves the running to others.

    rclpy would run a goal's callback in the executor until it ends. Here `execute_later`, which
    does that, comes at the end of a goal instead: so the final state and the result are set in the
    executor's thread, where no cancel request can come between them, and nothing ever waits there.

    Args:
        node: owner of the server.
        action_type: ROS type of the action.
        name: name of the action.
        start: gets each accepted goal, in the executor's thread; must not wait.
        result_timeout: s for which the result of a goal is kept.
    """

    def __init__(
        self,
        node: Any,
        action_type: Any,
        name: str,
        start: Callable[[Goal], None],
        result_timeout: int,
    ) -> None:
        self._start = start
        self._open: dict[bytes, Goal] = {}
        self._log_as_node = partial(log_as, node.get_logger())
        super().__init__(
            node,
            action_type,
            name,
            execute_callback=self._settle,
            goal_callback=lambda _request: GoalResponse.ACCEPT,
            handle_accepted_callback=self._accepted,
            cancel_callback=self._cancel_asked,
            goal_service_qos_profile=SERVICE_QOS,
            result_service_qos_profile=SERVICE_QOS,
            cancel_service_qos_profile=SERVICE_QOS,
            result_timeout=result_timeout,
        )

    @property
    def open_goals(self) -> int:
        """Goals that have not ended yet, and clients that have not got their results yet."""
        return len(self._open) + self.pending_results

    async def execute(self, taken_data: Any) -> None:
        """Called by rclpy with requests of clients. An error that escaped would end the spinning.

        A client that goes away while it waits for a result makes rclpy raise one.
        """
        self._log_as_node()
        try:
            if "cancel" in taken_data:
                self._cancel_again(taken_data["cancel"][1].goal_info)
            await super().execute(taken_data)
        except PEER_GONE_ERRORS as error:
            _LOG.warning("a request of an action's client failed: %s", error)

    def on_executing(self, goal_handle: Any) -> None:
        self._start(self._open[bytes(goal_handle.goal_id.uuid)])

    def finish(self, goal_handle: Any, outcome: Outcome, ret: Any) -> None:
        """Have the executor end a goal; from any thread."""
        self.execute_later(goal_handle, partial(self._settle, outcome=outcome, ret=ret))

    def _accepted(self, goal_handle: Any) -> None:
        self._open[bytes(goal_handle.goal_id.uuid)] = Goal(self, goal_handle)
        goal_handle.execute()

    def _cancel_asked(self, goal_handle: Any) -> Any:
        goal = self._open.get(bytes(goal_handle.goal_id.uuid))
        if goal is not None:
            goal.ask_to_cancel()
        return CancelResponse.ACCEPT

    def _cancel_again(self, goal_info: Any) -> None:
        """The chassis may have refused before; ROS knows no way back, and would drop the wish."""
        wanted = bytes(goal_info.goal_id.uuid)
        for uuid, goal in self._open.items():
            if goal.canceling and wanted in (uuid, _ANY_GOAL):
                goal.ask_to_cancel()

    def _settle(self, goal_handle: Any, outcome: Outcome, ret: Any) -> Any:
        try:
            if outcome is Outcome.SUCCEEDED:
                goal_handle.succeed()
            elif outcome is Outcome.CANCELED and goal_handle.is_cancel_requested:
                goal_handle.canceled()
            else:
                goal_handle.abort()
        except RCLError as error:
            _LOG.error("a goal could not be ended as %s: %s", outcome.value, error)
        self._open.pop(bytes(goal_handle.goal_id.uuid), None)
        return self.action_type.Result(ret=ret)
