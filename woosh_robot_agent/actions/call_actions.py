"""Goals of woosh.ros.CallAction: steps, lifts, paths and the like.

The chassis reports on them in woosh.ros.Feedbacks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.actions.attribution import Attribution
from woosh_robot_agent.actions.context import Context
from woosh_robot_agent.actions.kind import Findings, Order, Report, Start
from woosh_robot_agent.actions.outcome import Outcome
from woosh_robot_agent.link import Answer
from woosh_robot_agent.pb.ros import action_pb2, ros_pack_pb2
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction, Feedback, Feedbacks

_OUTCOMES = {
    ros_pack_pb2.kRosSuccess: Outcome.SUCCEEDED,
    ros_pack_pb2.kRosFailure: Outcome.ABORTED,
    ros_pack_pb2.kRosExecuteFailed: Outcome.ABORTED,
    ros_pack_pb2.kRosCancel: Outcome.CANCELED,
}
_NOT_OF_ACTIONS = (ros_pack_pb2.kRosWiFiCode, ros_pack_pb2.kRosWiFiJson)
"""States of feedback that does not concern an action."""


class CallActionGoal:
    """One command to an actuator or to the base.

    Args:
        arg: the command, as the client gave it.
        context: objects shared by all goals of the action.
        member: member of the oneof of CallAction.
        action: protobuf full name of the command, under which the chassis reports on it.
        last_feedback: the last feedback on each action, by that name.
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
        predecessors = context.open_goals.possibly_running(action)
        self.attribution = Attribution(
            predecessors,
            # another program's action may still report its cancel
            inherited=Outcome if predecessors else (Outcome.CANCELED,),
            repeats_ends=True,
            previous=last_feedback.get(action),
        )

    def request(self) -> Start | Order:
        self._command = self._context.to_proto(self._arg)
        if not _has_action(self._command):  # a setting, such as NavigationMode: nothing to report
            return Order(self._call(), self._success)
        action = self._command.action
        # the documented MoveBase example omits `action`, which then reads as 0, cancel
        if action == action_pb2.kCancel and not _is_empty(self._command):
            action = action_pb2.kExecute
        call = self._call(action)
        return Start(call) if action == action_pb2.kExecute else Order(call, self._success)

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
        return Feedback(action=self.name, state=ros_pack_pb2.kRosFailure, msg=reason)

    def _success(self, text: str) -> Message:
        return Feedback(action=self.name, state=ros_pack_pb2.kRosSuccess, msg=text)

    def _call(self, action: int | None = None) -> CallAction:
        call = CallAction()
        command: Any = getattr(call, self._member)
        command.CopyFrom(self._command)
        if action is None:
            command.SetInParent()  # present even if all fields have their default values
        else:
            command.action = action
        return call


def _has_action(command: Message) -> bool:
    """Return True if a command can be executed, paused, resumed and cancelled."""
    return "action" in command.DESCRIPTOR.fields_by_name


def _is_empty(command: Message) -> bool:
    """Return True if no field of a command is set, apart from `action`."""
    return all(
        field.name == "action" or (hasattr(value, "ListFields") and _is_empty(value))
        for field, value in command.ListFields()
    )
