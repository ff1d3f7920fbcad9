"""Goals of woosh.ros.CallAction: steps, lifts, paths and the like.

The chassis reports on them in woosh.ros.Feedbacks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert import BadFieldError
from woosh_robot_agent.link import Answer
from woosh_robot_agent.pb.ros import action_pb2, ros_pack_pb2
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction, Feedback, Feedbacks
from woosh_robot_agent.ros.actions.goal import (
    Attribution,
    Cause,
    End,
    Order,
    Outcome,
    PollResult,
    Report,
)
from woosh_robot_agent.ros.actions.run import GoalContext

_OUTCOMES = {
    ros_pack_pb2.kRosSuccess: Outcome.SUCCEEDED,
    ros_pack_pb2.kRosFailure: Outcome.ABORTED,
    ros_pack_pb2.kRosExecuteFailed: Outcome.ABORTED,
    ros_pack_pb2.kRosCancel: Outcome.CANCELED,
}
"""Outcome by the state in feedback. An action in any other state has not ended."""
_NOT_OF_ACTIONS = (ros_pack_pb2.kRosWiFiCode, ros_pack_pb2.kRosWiFiJson)
"""States of feedback that does not concern an action."""
_ACTIVE = (
    ros_pack_pb2.kRosExecuting,
    ros_pack_pb2.kRosPause,
    ros_pack_pb2.kRosPauseFailed,
    ros_pack_pb2.kRosErrMsg,
)
"""States of an action that has begun and not ended."""
_CANCEL_HINT = (
    "action 0 (K_CANCEL, also the default) only cancels; to execute the command, set "
    "action: {value: 1}"
)
"""Added to the result of each cancel, because clients often leave the field `action` blank."""


class CallActionGoal:
    """The goal to execute one command of an actuator or of the base.

    Args:
        arg: the command, as the client gave it.
        member: field of CallAction that holds the command.
        action: protobuf full name of the command, under which the chassis reports on it.
        last_feedback: the last feedback on each action, by the full name of the action's command.
    """

    def __init__(
        self,
        arg: Any,
        context: GoalContext,
        *,
        member: str,
        action: str,
        last_feedback: Mapping[str, Feedback],
    ) -> None:
        self.name = action  # feedback has no ids
        self.request_type = action
        self._arg = arg
        self._context = context
        self._member = member
        self._command: Any = None
        """The command to the chassis; set by `request`."""
        predecessors = context.open_goals.possibly_running(action)
        previous = last_feedback.get(action)
        was_active = previous is not None and previous.state in _ACTIVE
        self._may_be_active = was_active or predecessors > 0
        """True if the action may have been running or paused when the goal came."""
        self.attribution = Attribution(
            max(predecessors, int(was_active)),  # another program's action may be running
            # an action of another program may still report that it was cancelled
            inherited=tuple(Outcome) if predecessors else (Outcome.CANCELED,),
            repeats_ends=True,
            previous=previous,
        )

    def request(self) -> Message | Order:
        self._command = self._read_command()
        if "action" not in self._command.DESCRIPTOR.fields_by_name:
            # a setting, such as NavigationMode: the chassis only answers
            return Order(self._call_action(), self._success)
        if self._command.action == action_pb2.kExecute:
            return self._call_action()
        is_cancel = self._command.action == action_pb2.kCancel
        needs_report = is_cancel and not self._may_be_active
        return Order(self._call_action(), self._success, needs_cancel_report=needs_report)

    def _read_command(self) -> Message:
        """Return the command as a message for the chassis; an invalid cancel becomes blank."""
        try:
            return self._context.to_proto(self._arg)
        except BadFieldError:
            control = getattr(self._arg, "action", None)
            if control is None or control.value != action_pb2.kCancel:
                raise
            # nothing may prevent a cancel; a blank command is one, because kCancel is 0
            return self._context.to_proto(type(self._arg)())

    def cancel_request(self) -> Message:
        return self._call_action(action_pb2.kCancel)

    def read(self, message: Message) -> Iterable[Report]:
        if not isinstance(message, Feedbacks):
            return []
        return [
            Report(feedback, _OUTCOMES.get(feedback.state))
            for feedback in message.fbs
            if feedback.action == self.name and feedback.state not in _NOT_OF_ACTIONS
        ]

    def is_displaced(self, message: Message) -> bool:
        return False  # feedback on one action tells nothing about the others

    async def poll(self, on_result: Callable[[PollResult], None]) -> None:
        await self._context.chassis.request(
            self._context.requests.empty(Feedbacks),
            tap=lambda answer: on_result(self._read_poll(answer)),
        )

    def _read_poll(self, answer: Answer) -> PollResult:
        body = answer.body
        if not answer.ok or body is None:
            return PollResult()  # the chassis refuses polls: rely on its pushes
        return PollResult(tuple(self.read(body)))

    def note_polled_end(self, end: End) -> None:
        if end.cause is not Cause.AGENT:  # an action that the agent has given up may go on
            self._context.gate.wheel_owner.action_ended(self._command.DESCRIPTOR.name)

    def failure(self, reason: str) -> Message:
        return self._result(ros_pack_pb2.kRosFailure, reason)

    def _success(self, text: str) -> Message:
        return self._result(ros_pack_pb2.kRosSuccess, text)

    def _result(self, state: ros_pack_pb2.State, text: str) -> Feedback:
        if getattr(self._command, "action", None) == action_pb2.kCancel:  # a setting has none
            text = f"{text}; {_CANCEL_HINT}" if text else _CANCEL_HINT
        return Feedback(action=self.name, state=state, msg=text)

    def _call_action(self, action: int | None = None) -> CallAction:
        """Return the request with the command, whose field `action` is replaced if given."""
        call = CallAction()
        command: Any = getattr(call, self._member)
        command.CopyFrom(self._command)
        if action is not None:
            command.action = action
        return call
