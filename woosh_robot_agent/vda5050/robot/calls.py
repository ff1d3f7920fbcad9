"""The robot's own actions, e.g. of its lift: their start, pause, cancellation and end."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link import (
    Answer,
    ConnectionLostError,
    LinkError,
    LinkState,
    RequestTimeoutError,
)
from woosh_robot_agent.link.protos import full_name, message_type
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
_FAILED = Sentence("the robot failed")()
_NOT_SENT = Sentence("{name} was not sent: {reason}")
_UNKNOWN = Sentence("the robot does not tell how it ended")
_FAILURES = {
    ros_pack_pb2.kRosCancel: Sentence("it was cancelled at the robot")(),
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


class _Call:
    """One execution of an action of the robot, from its start to its end.

    Args:
        command: the command; `request` sets its field `action` (start, pause, resume or cancel).
        report: called with each new status: RUNNING or PAUSED.

    Attributes:
        accepted: True if the robot has accepted the start.
        reported: True if the robot has reported the action as executing or paused over the current
            link.
        cannot_pause: True if the robot could not pause the action. Always False for an action that
            moves the base, because its pause is repeated until the robot stands.
        ended: future that is done when the action has ended. Its result is the reason of the
            failure, or an empty text after a success.
        interrupts: True if an order must not go on after the action: the robot does not tell how it
            ended, or it was cancelled at the robot.
        is_leftover: True if the action was started before a restart of the program.
        result: text of the last report.
        controller: pauses, resumes and cancels the action.
    """

    controller: Controller
    """Set by `RobotCalls._new_call`, because it needs the call."""

    def __init__(self, command: Message, report: Callable[[ActionStatus], None]) -> None:
        self.command = command
        self.report = report
        self.accepted = False
        self.reported = False
        self.cannot_pause = False
        self.interrupts = False
        self.is_leftover = False
        self.ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self.result = ""

    @property
    def name(self) -> str:
        """Name of the command, for log and error texts."""
        return self.command.DESCRIPTOR.name

    def request(self, action: action_pb2.ControlAction) -> CallAction:
        """Return the request that starts, pauses, resumes or cancels the action."""
        message = CallAction()
        part: Any = getattr(message, _FIELDS[full_name(self.command)])
        part.CopyFrom(self.command)
        part.action = action
        return message

    def end(self, reason: str) -> None:
        """End the call, with the reason of the failure; empty after a success."""
        if not self.ended.done():
            self.ended.set_result(reason)
            self.controller.end()


class RobotCalls:
    """Executes the robot's own actions, one of each kind at a time.

    A start is never repeated. If its answer is lost, the reports of the robot decide. The robot is
    also asked from time to time, because it may drop an action without a report.
    """

    def __init__(self, link: RobotLink) -> None:
        self._link = link
        self._calls: dict[str, _Call] = {}
        """Current actions, by the full name of their command."""
        self._ends: dict[str, Feedback] = {}
        """Last reports on actions that have ended, by the full name of the command, until the next
        action of the kind is reported. The robot repeats such a report when it is asked: `_ask`
        must not take it for the end of a new action."""
        self._answers_queries = False
        """True once the robot has named an action when it was asked."""
        link.chassis.subscribe(Feedbacks, self._reported)
        link.chassis.on_snapshot(self._snapshot)
        link.chassis.on_state(self._link_changed)

    @property
    def commands(self) -> tuple[str, ...]:
        """Full names of the commands whose actions the robot executes."""
        return tuple(self._calls)

    @property
    def has_leftovers(self) -> bool:
        """True while the robot executes actions that were started before a restart."""
        return any(call.is_leftover for call in self._calls.values())

    @property
    def moves_base(self) -> bool:
        """True while the robot executes an action that moves its base."""
        return not self._calls.keys().isdisjoint(_MOVES_BASE)

    @property
    def all_paused(self) -> bool:
        """True if each running action is paused, or cannot be paused."""
        return all(
            call.controller.stays_paused or call.cannot_pause for call in self._calls.values()
        )

    @property
    def any_paused(self) -> bool:
        """True if an action is paused, by its last report."""
        return any(call.controller.paused for call in self._calls.values())

    def want(self, control: Control) -> None:
        """Pause or resume all actions as soon as possible; a cancelled one stays cancelled."""
        for call in self._calls.values():
            call.cannot_pause = False  # the robot may be able to now
            call.controller.want(control)

    def restore(self, commands: Iterable[str]) -> None:
        """Take over the actions that the robot may still execute after a restart of the program.

        Args:
            commands: `commands` before the restart.
        """
        for name in commands:
            call = self._calls[name] = self._new_call(message_type(name)(), lambda status: None)
            call.accepted = call.is_leftover = True
            self._ends.pop(name, None)  # an end that was reported since the restart may be its own
            call.ended.add_done_callback(partial(self._leftover_ended, name))
            self._ask_about(call)
            self._link.background.start(self._check(call))

    def _leftover_ended(self, name: str, _ended: asyncio.Future[str]) -> None:
        del self._calls[name]
        self._link.changed()

    def cancel_leftovers(self) -> None:
        """Cancel the actions that were started before a restart."""
        for call in self._calls.values():
            if call.is_leftover:
                call.controller.want(Control.CANCEL)

    def executes(self, command: Message) -> bool:
        """Return True while an action of the same kind has not ended."""
        return full_name(command) in self._calls

    async def perform(self, command: Message, report: Callable[[ActionStatus], None]) -> str:
        """Execute an action, and return the text of its last report.

        When cancelled, cancel the action at the robot, and wait for its end.

        Args:
            command: the command, a member of CallAction; none of its kind may be executed now.
            report: called when the robot has, or may have, accepted, paused or resumed the action.

        Raises:
            ActionFailedError: the action failed; of kind INTERRUPTED if its outcome is unknown, or
                if it was cancelled at the robot.
        """
        name = full_name(command)
        call = self._calls[name] = self._new_call(command, report)
        self._link.save()  # so that a kill from now on does not hide what the robot does
        try:
            await self._start(call)
            self._link.background.start(self._check(call))
            reason = await asyncio.shield(call.ended)
        except asyncio.CancelledError:
            if not self._link.is_closing:  # when the connector ends, the robot goes on
                call.controller.want(Control.CANCEL)
                await asyncio.wait({call.ended})
            raise
        finally:
            call.end("")  # so that nothing more is asked or commanded
            del self._calls[name]
        if reason:
            raise ActionFailedError(
                reason, ErrorType.INTERRUPTED if call.interrupts else ErrorType.ACTION
            )
        return call.result

    def _new_call(self, command: Message, report: Callable[[ActionStatus], None]) -> _Call:
        """Return a new call with a controller; the action is not started yet."""
        call = _Call(command, report)

        async def send(control: Control) -> Answer:
            def take_answer(answer: Answer) -> None:
                """Take the answer in order with the reports."""
                # a refusal before the action has begun does not mean that it cannot be paused
                if control is Control.PAUSE and not answer.ok and call.reported:
                    self._pause_failed(call)

            return await self._link.command(call.request(_CONTROLS[control]), tap=take_answer)

        def answered(control: Control) -> None:
            if control is Control.CANCEL:
                self._ask_about(call)  # so that its end is known even if no report tells it

        call.controller = Controller(self._link, call.name, send, answered)
        return call

    async def _start(self, call: _Call) -> None:
        """Send the start of an action.

        If it was sent, but not answered, ask the robot about the action instead of failing.

        Raises:
            ActionFailedError: the start was not sent, or the robot refused it.
        """

        def answered(answer: Answer) -> None:
            """Take the answer in order with the reports, which may come before it."""
            call.accepted = answer.ok
            if answer.ok and not call.reported:
                call.report(ActionStatus.RUNNING)

        try:
            answer = await self._link.command(call.request(action_pb2.kExecute), tap=answered)
        except (ConnectionLostError, RequestTimeoutError) as error:
            _LOG.warning("the start of %s was not answered: %s", call.name, error)
            call.report(ActionStatus.RUNNING)  # it may run, so it does not count as not begun
            if self._link.ready:
                self._ask_about(call)
        except LinkError as error:
            raise ActionFailedError(_NOT_SENT(name=call.name, reason=said_by(error))) from None
        else:
            if not answer.ok:
                raise ActionFailedError(ROBOT_REFUSED(what=call.name, reason=answer.reason))

    def _reported(self, reports: Feedbacks) -> None:
        """Handle pushed reports, which may be about several actions."""
        for report in reports.fbs:
            if call := self._calls.get(report.action):
                self._handle_report(call, report)
        self._note_ends(reports.fbs)

    def _note_ends(self, reports: Iterable[Feedback]) -> None:
        """Remember the ends of actions, and forget those after which another action has begun."""
        for report in reports:
            if report.state == ros_pack_pb2.kRosSuccess or report.state in _FAILURES:
                if report.action in _FIELDS:
                    self._ends[report.action] = report
            else:
                self._ends.pop(report.action, None)

    def _handle_report(self, call: _Call, report: Feedback) -> None:
        """Update an action from a report."""
        if report.state == ros_pack_pb2.kRosExecuting:
            if not (call.accepted or call.reported):
                call.report(ActionStatus.RUNNING)
            if not call.reported:
                call.reported = True
                call.controller.send_now()  # the robot may have refused a command before it began
            self._update_paused(call, paused=False)
        elif report.state == ros_pack_pb2.kRosPause:
            call.reported = True
            self._update_paused(call, paused=True)
        elif report.state == ros_pack_pb2.kRosPauseFailed:
            self._pause_failed(call)
        elif not (call.accepted or call.reported):
            return  # the end of an earlier action of this kind
        elif report.state == ros_pack_pb2.kRosSuccess:
            call.result = report.msg
            call.end("")
        elif report.state in _FAILURES:
            reason = _FAILURES[report.state]
            call.interrupts = report.state == ros_pack_pb2.kRosCancel
            call.end(WITH_TEXT(reason=reason, text=report.msg) if report.msg else reason)

    def _update_paused(self, call: _Call, *, paused: bool) -> None:
        """Update the controller from a report; report a change between paused and running."""
        was_paused = call.controller.paused
        if call.controller.update(paused):
            if paused != was_paused:
                call.report(ActionStatus.PAUSED if paused else ActionStatus.RUNNING)
            self._link.changed()

    def _pause_failed(self, call: _Call) -> None:
        """Take note that the robot cannot pause an action, so that no pause is sent again.

        A pause of an action that moves the base is sent until the robot stands.
        """
        if full_name(call.command) in _MOVES_BASE:
            return
        call.cannot_pause = True
        call.controller.withdraw_pause()
        self._link.changed()

    def _snapshot(self, info: RobotInfo) -> None:
        """Ask for the states of the actions after a reconnect, and for the ends of earlier ones."""
        self._link.background.start_once(self._learn_ends, self)
        for call in self._calls.values():
            self._ask_about(call)

    async def _learn_ends(self) -> None:
        """Ask for the ends of earlier actions, so that `_ask` does not take them for new ones."""

        def take_answer(answer: Answer) -> None:
            if isinstance(answer.body, Feedbacks):
                self._note_ends(each for each in answer.body.fbs if each.action not in self._calls)

        try:
            await self._link.wait_ready()
            await self._link.ask(Feedbacks(), tap=take_answer)
        except LinkError as error:
            _LOG.debug("no answer about earlier actions: %s", error)

    def _link_changed(self, state: LinkState) -> None:
        for call in self._calls.values():
            if state is not LinkState.READY:
                call.accepted |= call.reported  # what the robot executes, it has accepted
                call.reported = False  # is about the current link only
            call.controller.send_now()

    async def _check(self, call: _Call) -> None:
        """Ask the robot about an action from time to time until the action has ended."""
        while not call.ended.done():
            await asyncio.sleep(self._link.timing.check_every)
            if not call.ended.done():
                self._ask_about(call)

    def _ask_about(self, call: _Call) -> None:
        """Start `_ask` for an action, unless it runs already."""
        self._link.background.start_once(lambda: self._ask(call), call)

    async def _ask(self, call: _Call) -> None:
        """Ask the robot about an action until its state is known, or the link is lost.

        Give the action up if the robot answers for `Timing.give_up_after`, but knows nothing of it.
        If the robot pushes reports on the action, but never names one when it is asked, give the
        action up only after a cancellation that the robot has accepted.
        """
        clock = asyncio.get_running_loop().time
        name, deadline, is_known = full_name(call.command), math.inf, False

        def take_answer(answer: Answer) -> None:
            """Take the report on the action from an answer, and set `is_known`."""
            nonlocal is_known
            reports = answer.body.fbs if answer.ok and isinstance(answer.body, Feedbacks) else ()
            mine = [each for each in reports if each.action == name]
            self._answers_queries = self._answers_queries or bool(reports)
            # a robot that names no actions in its answers may push reports on them: these suffice,
            # except after an accepted cancellation, because the report on the end may be lost
            names_actions = answer.ok and self._answers_queries
            is_known = call.reported and not names_actions and not call.controller.cancel_accepted
            if mine and mine[-1] != self._ends.get(name):
                had_ended = call.ended.done()
                self._handle_report(call, mine[-1])
                if call.ended.done() and not had_ended:
                    self._link.gate.wheel_owner.action_ended(call.name)
                # if nothing shows that this call has begun, a reported end is of an earlier call
                is_known = call.accepted or call.reported
            self._note_ends(mine)

        while not call.ended.done():
            try:
                await self._link.wait_ready()
                await self._link.ask(Feedbacks(), tap=take_answer)
                if not (is_known or call.ended.done()) and clock() > deadline:
                    call.interrupts = True
                    call.end(_UNKNOWN())
                    if name in _MOVES_BASE:  # it may still move the robot
                        await self._cancel_unknown(call)
            except LinkError as error:
                _LOG.debug("reports on %s: %s", call.name, error)
                if not self._link.ready:
                    return  # asked again after a reconnect
                deadline = math.inf  # the robot has the full time again once it answers
            else:
                if is_known:
                    return
                # an action that has just begun may not be in the answer yet
                deadline = min(deadline, clock() + self._link.timing.give_up_after)
            await asyncio.sleep(self._link.timing.ask_every)

    async def _cancel_unknown(self, call: _Call) -> None:
        """Cancel an action that may go on until the robot answers, or another of its kind begins.

        Whatever the answer is, nothing of this kind goes on then.
        """

        def answered(answer: Answer) -> None:
            self._link.gate.wheel_owner.action_ended(call.name)
            self._link.changed()  # an order may wait for the end

        while self._calls.get(full_name(call.command), call) is call:
            try:
                await self._link.command(call.request(action_pb2.kCancel), tap=answered)
            except LinkError as error:
                _LOG.warning("the cancellation of %s was not answered: %s", call.name, error)
                await asyncio.sleep(self._link.timing.ask_every)
                await self._link.conditions.wait(lambda: self._link.ready)
            else:
                return
