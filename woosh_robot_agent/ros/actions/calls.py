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
    Findings,
    Order,
    Outcome,
    Report,
    Start,
)
from woosh_robot_agent.ros.actions.run import Context

_OUTCOMES = {
    ros_pack_pb2.kRosSuccess: Outcome.SUCCEEDED,
    ros_pack_pb2.kRosFailure: Outcome.ABORTED,
    ros_pack_pb2.kRosExecuteFailed: Outcome.ABORTED,
    ros_pack_pb2.kRosCancel: Outcome.CANCELED,
}
_NOT_OF_ACTIONS = (ros_pack_pb2.kRosWiFiCode, ros_pack_pb2.kRosWiFiJson)
"""States of feedback that does not concern an action."""
_RUNNING = (
    ros_pack_pb2.kRosExecuting,
    ros_pack_pb2.kRosPause,
    ros_pack_pb2.kRosPauseFailed,
    ros_pack_pb2.kRosErrMsg,
)
"""States of an action that has begun and not ended."""
_ONLY_CANCELS = (
    "action 0 (K_CANCEL, also the default) only cancels; to execute the command, set "
    "action: {value: 1}"
)


class CallActionGoal:
    """One command to an actuator or to the base.

    Args:
        arg: the command, as the client gave it.
        context: objects shared by all goals of the action.
        member: member of the oneof of CallAction.
        action: protobuf full name of the command, under which the chassis reports on it.
        last_feedback: the last feedback on each action, by the full name of the action's command.
    """

    def __init__(
        self,
        arg: Any,
        context: Context,
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
        self._is_cancel = False
        """True if the command is a cancel; set by `request`."""
        predecessors = context.open_goals.possibly_running(action)
        previous = last_feedback.get(action)
        self._may_run = bool(predecessors) or (previous is not None and previous.state in _RUNNING)
        """True if the action was running when the goal came, as far as is known."""
        self.attribution = Attribution(
            predecessors,
            # another program's action may still report its cancel
            inherited=Outcome if predecessors else (Outcome.CANCELED,),
            repeats_ends=True,
            previous=previous,
        )

    def request(self) -> Start | Order:
        self._command = self._read_command()
        if not _has_action(self._command):  # a setting, such as NavigationMode: nothing to report
            return Order(self._call(), self._success)
        if self._command.action == action_pb2.kExecute:
            return Start(self._call())
        self._is_cancel = self._command.action == action_pb2.kCancel
        needs_report = self._is_cancel and not self._may_run
        return Order(self._call(), self._success, needs_cancel_report=needs_report)

    def _read_command(self) -> Message:
        try:
            return self._context.to_proto(self._arg)
        except BadFieldError:
            control = getattr(self._arg, "action", None)
            if control is None or control.value != action_pb2.kCancel:
                raise
            return self._context.to_proto(type(self._arg)())  # nothing may prevent a cancel

    def cancel_request(self) -> Message:
        return self._call(action_pb2.kCancel)

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

    async def poll(self, found: Callable[[Findings], None]) -> None:
        request = self._context.empty(Feedbacks)
        await self._context.chassis.request(request, tap=lambda answer: found(self._read(answer)))

    def _read(self, answer: Answer) -> Findings:
        body = answer.body
        if not answer.ok or body is None:
            return Findings()  # the chassis refuses polls: rely on its pushes
        return Findings(tuple(self.read(body)))

    def failure(self, reason: str) -> Message:
        return self._result(ros_pack_pb2.kRosFailure, reason)

    def _success(self, text: str) -> Message:
        return self._result(ros_pack_pb2.kRosSuccess, text)

    def _result(self, state: ros_pack_pb2.State, text: str) -> Feedback:
        if self._is_cancel:
            text = f"{text}; {_ONLY_CANCELS}" if text else _ONLY_CANCELS
        return Feedback(action=self.name, state=state, msg=text)

    def _call(self, action: int | None = None) -> CallAction:
        call = CallAction()
        command: Any = getattr(call, self._member)
        command.CopyFrom(self._command)
        if action is not None:
            command.action = action
        return call


def _has_action(command: Message) -> bool:
    """Return True if a command can be executed, paused, resumed and cancelled."""
    return "action" in command.DESCRIPTOR.fields_by_name
