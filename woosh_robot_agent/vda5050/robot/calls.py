"""The robot's own actions, e.g. of its lift: their start, pause, cancellation and end."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link import (
    Answer,
    ConnectionLostError,
    LinkError,
    LinkState,
    RequestTimeoutError,
)
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.ros import action_pb2, ros_pack_pb2
from woosh_robot_agent.pb.ros.action_pb2 import ChargeControl, MoveBase, StepControl
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction, Feedback, Feedbacks
from woosh_robot_agent.sentences import Sentence, said_by
from woosh_robot_agent.vda5050.messages.state import (
    ROBOT_REFUSED,
    WITH_TEXT,
    ActionFailedError,
    ActionStatus,
    ErrorType,
)
from woosh_robot_agent.vda5050.orders.legs import Control
from woosh_robot_agent.vda5050.robot.control import Controller
from woosh_robot_agent.vda5050.robot.link import RobotLink

_LOG = logging.getLogger(__name__)
_ASK_EVERY = 1.0
"""Pause between two queries about an action, in seconds."""
_FAILED = Sentence("vda.failed", "the robot failed")()
_ANOTHER = Sentence("vda.another", "the robot executes another {name} already")
_NOT_SENT = Sentence("vda.notSent", "{name} was not sent: {reason}")
_UNKNOWN = Sentence("vda.unknownEnd", "the robot does not tell how it ended")
_FAILURES = {
    ros_pack_pb2.kRosCancel: Sentence("vda.cancelledAtRobot", "it was cancelled at the robot")(),
    ros_pack_pb2.kRosFailure: _FAILED,
    ros_pack_pb2.kRosExecuteFailed: _FAILED,
}
"""Reasons why an action did not succeed, by the state in its last report."""
_FIELDS = {
    field.message_type.full_name: field.name
    for field in CallAction.DESCRIPTOR.oneofs_by_name["action"].fields
    if field.message_type is not None
}
"""Names of the fields of CallAction, by the full name of the command."""
_MOVES_BASE = frozenset(map(full_name, (ChargeControl, MoveBase, StepControl)))
"""Commands that move the base."""
_CONTROLS = {
    Control.PAUSE: action_pb2.kPause,
    Control.RESUME: action_pb2.kResume,
    Control.CANCEL: action_pb2.kCancel,
}


class _Run:
    """One execution of an action of the robot, from its start to its end.

    Args:
        command: the command, without its field `action` (start, pause, resume or cancel).
        report: called with each new status: RUNNING or PAUSED.

    Attributes:
        accepted: True if the robot has accepted the start.
        reported: True if the robot has reported the action as executing or paused.
        cannot_pause: True if the robot could not pause the action.
        ended: future that is done when the action has ended. Its result is the reason of the
            failure, or an empty text after a success.
        outcome_unknown: True if the robot does not tell how the action ended.
        result: text of the last report.
        controller: pauses, resumes and cancels the action.
    """

    controller: Controller
    """Set by `RobotCalls._new_run`, because it needs the run."""

    def __init__(self, command: Message, report: Callable[[ActionStatus], None]) -> None:
        self.command = command
        self.report = report
        self.accepted = False
        self.reported = False
        self.cannot_pause = False
        self.outcome_unknown = False
        self.ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self.result = ""

    @property
    def name(self) -> str:
        """Name of the command, for log and error texts."""
        return self.command.DESCRIPTOR.name

    def request(self, action: action_pb2.ControlAction) -> CallAction:
        """Return the request that starts, pauses, resumes or cancels the action."""
        call = CallAction()
        part: Any = getattr(call, _FIELDS[full_name(self.command)])
        part.CopyFrom(self.command)
        part.action = action
        return call

    def end(self, reason: str) -> None:
        """End the run, with the reason of the failure; empty after a success."""
        if not self.ended.done():
            self.ended.set_result(reason)
            self.controller.end()


class RobotCalls:
    """Executes the robot's own actions, one of each kind at a time.

    A start is never repeated. If its answer is lost, the reports of the robot decide.
    """

    def __init__(self, link: RobotLink) -> None:
        self._link = link
        self._runs: dict[str, _Run] = {}
        """Current actions, by the full name of their command."""
        link.chassis.subscribe(Feedbacks, self._reported)
        link.chassis.on_snapshot(self._snapshot)
        link.chassis.on_state(self._link_changed)

    @property
    def busy(self) -> bool:
        """True while the robot executes an action."""
        return bool(self._runs)

    @property
    def moves_base(self) -> bool:
        """True while the robot executes an action that moves its base."""
        return not self._runs.keys().isdisjoint(_MOVES_BASE)

    @property
    def all_paused(self) -> bool:
        """True if each running action is paused, or cannot be paused."""
        return all(run.controller.stays_paused or run.cannot_pause for run in self._runs.values())

    def want(self, control: Control) -> None:
        """Pause or resume all actions, as `Controller.want` does."""
        for run in self._runs.values():
            run.cannot_pause = False  # the robot may be able to now
            run.controller.want(control)

    async def perform(self, command: Message, report: Callable[[ActionStatus], None]) -> str:
        """Execute an action, and return the text of its last report.

        When cancelled, cancel the action at the robot, and wait for its end.

        Args:
            command: the command, a member of CallAction.
            report: called when the robot accepts, pauses or resumes the action.

        Raises:
            ActionFailedError: the action failed; of kind INTERRUPTED if its outcome is unknown.
        """
        name = full_name(command)
        if name in self._runs:
            raise ActionFailedError(_ANOTHER(name=command.DESCRIPTOR.name))
        run = self._runs[name] = self._new_run(command, report)
        try:
            await self._start(run)
            reason = await asyncio.shield(run.ended)
        except asyncio.CancelledError:
            if not self._link.is_closing:  # when the connector ends, the robot goes on
                run.controller.want(Control.CANCEL)
                await asyncio.wait({run.ended})
            raise
        finally:
            run.end("")  # so that nothing more is asked or commanded
            del self._runs[name]
        if reason:
            raise ActionFailedError(
                reason, ErrorType.INTERRUPTED if run.outcome_unknown else ErrorType.ACTION
            )
        return run.result

    def _new_run(self, command: Message, report: Callable[[ActionStatus], None]) -> _Run:
        run = _Run(command, report)

        async def send(control: Control) -> Answer:
            return await self._link.command(run.request(_CONTROLS[control]))

        def answered(control: Control, answer: Answer | None) -> None:
            if answer is None:
                return
            if control is Control.CANCEL:
                self._ask_about(run)  # so that its end is known even if no report tells it
            # a refusal before the action has begun does not mean that the action cannot be paused
            elif control is Control.PAUSE and not answer.ok and (run.accepted or run.reported):
                self._pause_failed(run)

        run.controller = Controller(self._link, run.name, send, answered)
        return run

    async def _start(self, run: _Run) -> None:
        def answered(answer: Answer) -> None:
            """Take the answer in order with the reports, which may come before it."""
            run.accepted = answer.ok
            if answer.ok and not run.reported:
                run.report(ActionStatus.RUNNING)

        try:
            answer = await self._link.command(run.request(action_pb2.kExecute), tap=answered)
        except (ConnectionLostError, RequestTimeoutError) as error:
            _LOG.warning("the start of %s was not answered: %s", run.name, error)
            if self._link.ready:
                self._ask_about(run)
        except LinkError as error:
            raise ActionFailedError(_NOT_SENT(name=run.name, reason=said_by(error))) from None
        else:
            if not answer.ok:
                raise ActionFailedError(ROBOT_REFUSED(what=run.name, reason=answer.msg))

    def _reported(self, reports: Feedbacks) -> None:
        for report in reports.fbs:
            if run := self._runs.get(report.action):
                self._handle_report(run, report)

    def _handle_report(self, run: _Run, report: Feedback) -> None:
        """Update an action from a report."""
        if report.state == ros_pack_pb2.kRosExecuting:
            if not (run.accepted or run.reported):
                run.report(ActionStatus.RUNNING)
            run.reported = True
            self._update_paused(run, paused=False)
        elif report.state == ros_pack_pb2.kRosPause:
            run.reported = True
            self._update_paused(run, paused=True)
        elif report.state == ros_pack_pb2.kRosPauseFailed:
            self._pause_failed(run)
        elif not (run.accepted or run.reported):
            return  # the end of an earlier action of this kind
        elif report.state == ros_pack_pb2.kRosSuccess:
            run.result = report.msg
            run.end("")
        elif report.state in _FAILURES:
            reason = _FAILURES[report.state]
            run.end(WITH_TEXT(reason=reason, text=report.msg) if report.msg else reason)

    def _update_paused(self, run: _Run, *, paused: bool) -> None:
        was_paused = run.controller.paused
        if run.controller.update(paused):
            if paused != was_paused:
                run.report(ActionStatus.PAUSED if paused else ActionStatus.RUNNING)
            self._link.changed()

    def _pause_failed(self, run: _Run) -> None:
        """Take note that the robot cannot pause an action, so that no pause is sent again."""
        run.cannot_pause = True
        run.controller.withdraw_pause()
        self._link.changed()

    def _snapshot(self, info: RobotInfo) -> None:
        """Ask for the states of the actions after a reconnect."""
        for run in self._runs.values():
            self._ask_about(run)

    def _link_changed(self, state: LinkState) -> None:
        for run in self._runs.values():
            run.controller.link_changed()

    def _ask_about(self, run: _Run) -> None:
        """Ask the robot about an action, until it answers or the link is lost."""
        self._link.background.start_once(lambda: self._ask(run), run)

    async def _ask(self, run: _Run) -> None:
        def take_answer(answer: Answer) -> None:
            reports = answer.body.fbs if answer.ok and isinstance(answer.body, Feedbacks) else ()
            mine = [each for each in reports if each.action == full_name(run.command)]
            if mine:
                self._handle_report(run, mine[-1])
            # if nothing shows that this run has begun, the reported end is that of an earlier run
            if not mine or not (run.accepted or run.reported):
                run.outcome_unknown = True
                run.end(_UNKNOWN())

        while not run.ended.done():
            try:
                await self._link.wait_ready()
                await self._link.ask(Feedbacks(), tap=take_answer)
            except LinkError as error:
                _LOG.debug("reports on %s: %s", run.name, error)
            else:
                return
            if not self._link.ready:
                return  # asked again after a reconnect
            await asyncio.sleep(_ASK_EVERY)
