"""The ROS side of the actions: an action server whose goals run in the link thread."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.action import CancelResponse, GoalResponse

from woosh_robot_agent.ros.actions.goal import Outcome
from woosh_robot_agent.ros.logs import log_as
from woosh_robot_agent.ros.qos import FEEDBACK_QOS, SERVICE_QOS
from woosh_robot_agent.ros.rclpy_private import PEER_GONE_ERRORS, DeferringActionServer, RCLError

_LOG = logging.getLogger(__name__)
_ANY_GOAL = bytes(16)
"""Goal id of a cancel request for all goals."""


class Goal:
    """Interface of an accepted goal for the link thread.

    Args:
        server: the server that accepted it.
        handle: rclpy's handle of the goal.
    """

    def __init__(self, server: GoalServer, handle: Any) -> None:
        self._server = server
        self._handle = handle
        self._lock = threading.Lock()
        self._finished = False
        """True once `finish` was called."""
        self.arg: Any = handle.request.arg
        """The command, as the client gave it."""
        self.taken = time.monotonic()
        """Monotonic time at which the goal was accepted."""
        self._cancel_requested = False
        """True once a client has asked to cancel the goal."""
        self._on_cancel: Callable[[], None] | None = None

    def on_cancel(self, callback: Callable[[], None]) -> None:
        """Call `callback` when a client asks to cancel the goal, or now if one has asked."""
        with self._lock:
            self._on_cancel = callback
            requested = self._cancel_requested
        if requested:
            callback()

    def request_cancel(self) -> None:
        """Note that a client asks to cancel the goal; in the executor thread."""
        with self._lock:
            self._cancel_requested = True
            callback = self._on_cancel
        if callback is not None:
            callback()

    @property
    def canceling(self) -> bool:
        """True while the goal is being cancelled for a client."""
        return bool(self._handle.is_cancel_requested)

    def feedback(self, fb: Any) -> None:
        """Publish feedback; does nothing once the goal has ended."""
        with self._lock:
            if self._finished:
                return
            try:
                self._handle.publish_feedback(self._server.action_type.Feedback(fb=fb))
            except PEER_GONE_ERRORS as error:
                _LOG.debug("cannot publish feedback on a goal: %s", error)

    def finish(self, outcome: Outcome, ret: Any) -> None:
        """End the goal; only the first call has an effect."""
        with self._lock:
            if self._finished:
                return
            self._finished = True
        self._server.finish(self._handle, outcome, ret)


class GoalServer(DeferringActionServer):
    """An action server that accepts every goal and every cancel, and executes nothing itself.

    In rclpy, the execute callback runs from the start of a goal to its end. Here, `execute_later`
    schedules it only at the end, to set the final state and return the result. So no callback
    waits. A cancel request cannot come between final state and result, because the executor thread
    handles all of them.

    Args:
        node: owner of the server.
        action_type: ROS type of the action.
        name: name of the action.
        start: called with each accepted goal in the executor thread; must not block.
        result_timeout: time for which the result of a goal is kept, in seconds.
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
        """Goals whose final state is not set yet, by the bytes of their ids."""
        self._log_as_node = partial(log_as, node.get_logger())
        super().__init__(
            node,
            action_type,
            name,
            execute_callback=self._set_final_state,
            goal_callback=lambda _request: GoalResponse.ACCEPT,
            handle_accepted_callback=self._accepted,
            cancel_callback=self._cancel_requested,
            goal_service_qos_profile=SERVICE_QOS,
            result_service_qos_profile=SERVICE_QOS,
            cancel_service_qos_profile=SERVICE_QOS,
            feedback_pub_qos_profile=FEEDBACK_QOS,
            result_timeout=result_timeout,
        )

    @property
    def open_goals(self) -> int:
        """Number of goals that have not ended, plus clients that wait for a result."""
        return len(self._open) + self.pending_results

    async def execute(self, taken_data: Any) -> None:
        """Serve requests of clients; called by rclpy.

        An exception would end the executor's spinning. rclpy raises one if a client disappears
        while it waits for a result.
        """
        self._log_as_node()
        try:
            if "cancel" in taken_data:
                self._cancel_again(taken_data["cancel"][1].goal_info)
            await super().execute(taken_data)
        except PEER_GONE_ERRORS as error:
            _LOG.warning("cannot serve a client of an action: %s", error)

    def on_executing(self, goal_handle: Any) -> None:
        self._start(self._open[bytes(goal_handle.goal_id.uuid)])

    def finish(self, goal_handle: Any, outcome: Outcome, ret: Any) -> None:
        """End a goal in the executor thread; callable from any thread."""
        self.execute_later(goal_handle, partial(self._set_final_state, outcome=outcome, ret=ret))

    def _accepted(self, goal_handle: Any) -> None:
        self._open[bytes(goal_handle.goal_id.uuid)] = Goal(self, goal_handle)
        goal_handle.execute()

    def _cancel_requested(self, goal_handle: Any) -> Any:
        goal = self._open.get(bytes(goal_handle.goal_id.uuid))
        if goal is not None:
            goal.request_cancel()
        return CancelResponse.ACCEPT

    def _cancel_again(self, goal_info: Any) -> None:
        """Forward a repeated cancel request: the chassis may have refused the first one.

        rclpy itself ignores it, because the goal is already in the state canceling.
        """
        wanted = bytes(goal_info.goal_id.uuid)
        for uuid, goal in self._open.items():
            if goal.canceling and wanted in (uuid, _ANY_GOAL):
                goal.request_cancel()

    def _set_final_state(self, goal_handle: Any, outcome: Outcome, ret: Any) -> Any:
        try:
            if outcome is Outcome.SUCCEEDED:
                goal_handle.succeed()
            elif outcome is Outcome.CANCELED and goal_handle.is_cancel_requested:
                goal_handle.canceled()
            else:
                goal_handle.abort()
        except RCLError as error:
            _LOG.error("cannot end a goal as %s: %s", outcome.value, error)
        self._open.pop(bytes(goal_handle.goal_id.uuid), None)
        return self.action_type.Result(ret=ret)
