"""Goals that woosh.ros.CallAction starts and woosh.ros.Feedbacks reports on: steps, lifts, ways."""

from __future__ import annotations

from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.actions.events import End, Report
from woosh_robot_agent.actions.run import NO_REASON, Context, GoalRun
from woosh_robot_agent.actions.server import Goal, Outcome
from woosh_robot_agent.link import LinkError
from woosh_robot_agent.pb.ros import action_pb2, ros_pack_pb2
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction, Feedback, Feedbacks

_OUTCOMES = {
    ros_pack_pb2.kRosSuccess: Outcome.SUCCEEDED,
    ros_pack_pb2.kRosFailure: Outcome.ABORTED,
    ros_pack_pb2.kRosExecuteFailed: Outcome.ABORTED,
    ros_pack_pb2.kRosCancel: Outcome.CANCELED,
}
_NO_ACTIONS = (ros_pack_pb2.kRosWiFiCode, ros_pack_pb2.kRosWiFiJson)


class CallActionRun(GoalRun):
    """One command to an actuator or to the base.

    Args:
        member: member of the oneof of CallAction.
        action: protobuf full name of the command, by which the chassis reports on it.
        known: the last feedback of each action, kept by the runs.
    """

    def __init__(
        self,
        goal: Goal,
        context: Context,
        *,
        member: str,
        action: str,
        known: dict[str, Feedback],
    ) -> None:
        super().__init__(goal, context)
        self._member = member
        self._action = action
        self._command: Any = None
        # feedbacks have no id: the end of what ran before must not count as that of this goal
        self.predecessors = self.runs.moving
        self.inherited = tuple(Outcome) if self.predecessors else (Outcome.CANCELED,)
        self._last: Feedback | None = None
        self._before = known.get(action)

    async def live(self) -> End:
        """Start what the goal commands and follow it, or pass on an order about what runs."""
        self._command = self.to_proto(self.goal.arg)
        # the documented MoveBase example gives no action, which reads as 0, cancel
        if self._command.action == action_pb2.kCancel and not is_empty(self._command):
            self._command.action = action_pb2.kExecute
        if self._command.action == action_pb2.kExecute:
            return await super().live()
        return await self._order()

    def make_request(self) -> Message:
        """See `GoalRun.make_request`."""
        return self._call(self._command.action)

    def make_cancel(self) -> Message:
        """See `GoalRun.make_cancel`."""
        return self._call(action_pb2.kCancel)

    def failed(self, reason: str) -> Message:
        """See `GoalRun.failed`."""
        return Feedback(action=self._action, state=ros_pack_pb2.kRosFailure, msg=reason)

    def read(self, report: Message) -> End | None:
        """See `GoalRun.read`."""
        if not isinstance(report, Feedbacks):
            return None
        for feedback in report.fbs:
            if feedback.action != self._action or feedback.state in _NO_ACTIONS:
                continue
            outcome = _OUTCOMES.get(feedback.state)
            if not self.is_mine(outcome):
                continue
            self._last = feedback
            self.heard()
            self.goal.feedback(self.to_ros(feedback))
            if outcome is not None:
                return End(outcome, feedback)
        return None

    async def recover(self) -> End | None:
        """See `GoalRun.recover`. A chassis that refuses to be asked has to report by itself."""
        answer = await self.chassis.request(self.query(Feedbacks))
        if not answer.ok or not isinstance(answer.body, Feedbacks):
            return None
        for feedback in answer.body.fbs:
            if feedback.action != self._action:
                continue
            if feedback == self._last:  # told already
                self.heard()
            elif self._is_news(feedback):
                self.post(Report(Feedbacks(fbs=[feedback])))
        return None

    def _is_news(self, feedback: Feedback) -> bool:
        """Whether it can be on this goal: the chassis also gives what it did before."""
        if self.was_heard or feedback.state not in _OUTCOMES:
            return True
        before, self._before = self._before, None
        if self.took.done():
            return feedback != before  # the second time it is: this goal ended in the same way
        self._before = before
        return before is not None and feedback != before

    async def _order(self) -> End:
        """Such a goal ends with the answer, and leaves the running goal in charge."""
        self.took.set_result(False)
        try:
            answer = await self.gate.request(self.make_request())
        except LinkError as error:
            return self.aborted(str(error))
        if not answer.ok:
            return self.aborted(answer.msg or NO_REASON)
        done = Feedback(action=self._action, state=ros_pack_pb2.kRosSuccess, msg=answer.msg)
        return End(Outcome.SUCCEEDED, done)

    def _call(self, action: int) -> CallAction:
        call = CallAction()
        command: Any = getattr(call, self._member)
        command.CopyFrom(self._command)
        command.action = action
        return call


def is_empty(command: Message) -> bool:
    """Whether a command says nothing but, perhaps, its `action`."""
    return all(
        field.name == "action" or (hasattr(value, "ListFields") and is_empty(value))
        for field, value in command.ListFields()
    )
