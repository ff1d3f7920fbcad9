"""Calls to the robot on behalf of actions: pause, cancellation, conditions and errors."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.link import (
    Answer,
    ChassisClient,
    ConnectionLostError,
    LinkError,
    LinkState,
    NotConnectedError,
    RequestTimeoutError,
)
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.ros import action_pb2, ros_pack_pb2
from woosh_robot_agent.pb.ros.action_pb2 import ChargeControl, MoveBase, StepControl
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction, Feedback, Feedbacks
from woosh_robot_agent.vda5050.background import BackgroundTasks
from woosh_robot_agent.vda5050.messages.state import ActionStatus, ErrorType


@dataclass(frozen=True)
class Objection:
    """A reason why the vehicle cannot perform an action.

    Attributes:
        reason: the reason.
        parameter: key of the wrong or missing parameter; empty if it is not about a parameter.
    """

    reason: str
    parameter: str = ""

    @property
    def references(self) -> dict[str, str]:
        """References for the error that reports it."""
        return {"actionParameter": self.parameter} if self.parameter else {}


class ActionFailedError(Exception):
    """An action failed. The text is the reason.

    Args:
        reason: the reason.
        kind: type of the error that reports it.
    """

    def __init__(self, reason: str, kind: ErrorType = ErrorType.ACTION) -> None:
        super().__init__(reason)
        self.kind = kind


class Conditions:
    """Conditions that actions wait for. Call `check` after each event. Used in one event loop."""

    def __init__(self) -> None:
        self._waiting: dict[asyncio.Future[None], Callable[[], bool]] = {}

    async def wait(self, condition: Callable[[], bool], timeout: float | None = None) -> bool:
        """Wait until a condition holds; return False if it does not within `timeout` seconds."""
        if condition():
            return True
        holds = asyncio.get_running_loop().create_future()
        self._waiting[holds] = condition
        try:
            await (holds if timeout is None else run_with_timeout(timeout, holds))
        except TimeoutError:
            return False
        finally:
            del self._waiting[holds]
        return True

    def check(self) -> None:
        """Wake the waiting callers whose condition holds now."""
        for holds, condition in self._waiting.items():
            if not holds.done() and condition():
                holds.set_result(None)


class Pause:
    """The pause of a vehicle.

    Attributes:
        wanted: True if the vehicle is, or must be, paused.
    """

    def __init__(self) -> None:
        self.wanted = False
        self._participants: list[tuple[Callable[[bool], None], Callable[[], bool]]] = []

    def join(self, apply: Callable[[bool], None], is_paused: Callable[[], bool]) -> None:
        """Add something that moves the robot.

        Args:
            apply: called with True to pause it, with False to resume it.
            is_paused: returns True if it does not move, or cannot be paused.
        """
        self._participants.append((apply, is_paused))

    def set(self, wanted: bool) -> None:
        """Pause or resume everything; idempotent."""
        if wanted != self.wanted:
            self.wanted = wanted
            for apply, _ in self._participants:
                apply(wanted)

    @property
    def in_effect(self) -> bool:
        """True once everything is paused."""
        return self.wanted and all(is_paused() for _, is_paused in self._participants)


_LOG = logging.getLogger(__name__)
_REPEAT_AFTER = 3.0
"""Time after which a command that stops an action is repeated if it had no effect, in seconds."""
_ASK_EVERY = 1.0
"""Pause between two queries about an action, in seconds."""
_READY_TIMEOUT = 5.0
"""Maximum time from a snapshot until the link is ready, in seconds."""
_FAILURES = {
    ros_pack_pb2.kRosCancel: "it was cancelled at the robot",
    ros_pack_pb2.kRosFailure: "the robot failed",
    ros_pack_pb2.kRosExecuteFailed: "the robot failed",
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


class _Run:
    """An action that the robot executes.

    Args:
        command: the command, without its `action`.
        report: called with each new status: it runs, or is paused.

    Attributes:
        accepted: the robot has accepted the start.
        heard: the robot has reported that it executes, or has paused, the action.
        paused: the robot has reported that the action is paused.
        resuming: the robot was told to resume it, and has not reported about it since.
        cannot_pause: the robot could not pause it.
        wanted: command that the robot must obey; None without one.
        wake: set when `wanted` or `paused` has changed.
        insisting: sends `wanted` until the robot has obeyed; None if that was never needed.
        inquiry: asks the robot about the action; None if that was never needed.
        ended: future of the reason of the failure; empty after a success.
        unknown: the robot does not tell how the action ended.
        result: text of the last report.
    """

    def __init__(self, command: Message, report: Callable[[ActionStatus], None]) -> None:
        self.command = command
        self.report = report
        self.accepted = False
        self.heard = False
        self.paused = False
        self.resuming = False
        self.cannot_pause = False
        self.unknown = False
        self.wanted: action_pb2.ControlAction | None = None
        self.wake = asyncio.Event()
        self.insisting: asyncio.Task[None] | None = None
        self.inquiry: asyncio.Task[None] | None = None
        self.ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self.result = ""

    @property
    def name(self) -> str:
        """Name of the command, for log and error texts."""
        return self.command.DESCRIPTOR.name

    def call(self, action: action_pb2.ControlAction) -> CallAction:
        """Return the request that starts, pauses, resumes or cancels the action."""
        call = CallAction()
        part: Any = getattr(call, _FIELDS[full_name(self.command)])
        part.CopyFrom(self.command)
        part.action = action
        return call

    @property
    def stands(self) -> bool:
        """True while the action is paused, and was not resumed."""
        return self.paused and not self.resuming

    @property
    def due(self) -> action_pb2.ControlAction | None:
        """Command that the robot has not obeyed; None without one."""
        if self.ended.done() or (self.wanted == action_pb2.kPause and self.stands):
            return None
        return self.wanted

    def end(self, reason: str) -> None:
        """End the run, with the reason why it failed; empty if it succeeded."""
        if not self.ended.done():
            self.ended.set_result(reason)
            self.wake.set()


class RobotCalls:
    """Executes the robot's own actions, one of each kind at a time.

    A start is never repeated. If its answer is lost, the reports of the robot decide. A pause or a
    cancellation is repeated until the robot reports its effect, because it only stops the robot.

    Args:
        chassis: the link; used in its event loop only.
        gate: sends the commands.
        requests: addresses the requests.
        pause: pauses and resumes the actions.
        conditions: checked when the robot has paused an action.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        requests: RequestMaker,
        pause: Pause,
        conditions: Conditions,
    ) -> None:
        self._chassis = chassis
        self._gate = gate
        self._requests = requests
        self._conditions = conditions
        self._runs: dict[str, _Run] = {}
        """Current actions, by the full name of their command."""
        self._closing = False
        self._log = LogOnce(_LOG)
        self._tasks = BackgroundTasks("vda5050 call")
        chassis.subscribe(Feedbacks, self._reported)
        chassis.on_snapshot(self._snapshot)
        chassis.on_state(self._link_changed)
        pause.join(self._pause, self._is_paused)

    @property
    def busy(self) -> bool:
        """True while the robot executes an action."""
        return bool(self._runs)

    @property
    def moves_base(self) -> bool:
        """True while the robot executes an action that moves its base."""
        return not self._runs.keys().isdisjoint(_MOVES_BASE)

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
            raise ActionFailedError(f"the robot executes another {command.DESCRIPTOR.name} already")
        self._log.clear()
        run = self._runs[name] = _Run(command, report)
        try:
            await self._start(run)
            reason = await asyncio.shield(run.ended)
        except asyncio.CancelledError:
            if not self._closing:
                self._want(run, action_pb2.kCancel)
                await asyncio.wait({run.ended})
            raise
        finally:
            run.end("it is not followed any more")
            del self._runs[name]
        if reason:
            raise ActionFailedError(
                reason, ErrorType.INTERRUPTED if run.unknown else ErrorType.ACTION
            )
        return run.result

    async def close(self) -> None:
        """Stop waiting for answers; the robot goes on with its actions."""
        self._closing = True
        await self._tasks.close()

    async def _start(self, run: _Run) -> None:
        def answered(answer: Answer) -> None:
            run.accepted = answer.ok
            if answer.ok and not run.heard:
                run.report(ActionStatus.RUNNING)

        request = run.call(action_pb2.kExecute)
        try:
            answer = await self._gate.request(request, tap=answered)
        except (ConnectionLostError, RequestTimeoutError) as error:
            _LOG.warning("the start of %s was not answered: %s", run.name, error)
            if self._chassis.state is LinkState.READY:
                self._inquire(run)
        except LinkError as error:
            raise ActionFailedError(f"{run.name} was not sent: {error}") from None
        else:
            if not answer.ok:
                raise ActionFailedError(f"the robot refused {run.name}: {answer.msg}")

    def _want(self, run: _Run, command: action_pb2.ControlAction) -> None:
        """Let the robot pause, resume or cancel an action; nothing replaces a cancellation."""
        if run.wanted != action_pb2.kCancel:
            run.wanted = command
            self._pursue(run)

    def _pursue(self, run: _Run) -> None:
        """Begin to send what is wanted, if the robot has not obeyed."""
        run.wake.set()
        if run.due is not None and (run.insisting is None or run.insisting.done()):
            run.insisting = self._tasks.start(self._insist(run))

    async def _insist(self, run: _Run) -> None:
        """Send what is wanted until the robot has obeyed. A resumption is sent once."""
        while (command := run.due) is not None:
            run.wake.clear()
            if self._chassis.state is LinkState.READY:
                await self._control(run, command)
            with contextlib.suppress(TimeoutError):
                await run_with_timeout(_REPEAT_AFTER, run.wake.wait())

    async def _control(self, run: _Run, command: action_pb2.ControlAction) -> None:
        """Pause, resume or cancel an action."""
        text = f"{action_pb2.ControlAction.Name(command)} of {run.name}"
        if command == action_pb2.kResume:
            run.wanted, run.resuming = None, True
        try:
            answer = await self._gate.request(run.call(command))
        except LinkError as error:
            self._log.warn(text, f"{text} was not sent or not answered: {error}")
            if isinstance(error, NotConnectedError) and run.wanted is None:
                run.wanted, run.resuming = command, False
            return
        if not answer.ok:
            self._log.warn(text, f"the robot refused {text}: {answer.msg}")
            if command == action_pb2.kPause and (run.accepted or run.heard):
                self._show_unpausable(run)
        if command == action_pb2.kCancel:
            self._inquire(run)

    def _reported(self, reports: Feedbacks) -> None:
        for report in reports.fbs:
            if run := self._runs.get(report.action):
                self._judge(run, report)

    def _judge(self, run: _Run, report: Feedback) -> None:
        """Take a report on an action."""
        if report.state == ros_pack_pb2.kRosExecuting:
            if not (run.accepted or run.heard):
                run.report(ActionStatus.RUNNING)
            run.heard = True
            self._show_paused(run, False)
        elif report.state == ros_pack_pb2.kRosPause:
            run.heard = True
            self._show_paused(run, True)
        elif report.state == ros_pack_pb2.kRosPauseFailed:
            self._show_unpausable(run)
        elif not (run.accepted or run.heard):
            return  # the end of an earlier action of this kind
        elif report.state == ros_pack_pb2.kRosSuccess:
            run.result = report.msg
            run.end("")
        elif report.state in _FAILURES:
            reason = _FAILURES[report.state]
            run.end(f"{reason}: {report.msg}" if report.msg else reason)

    def _show_paused(self, run: _Run, paused: bool) -> None:
        run.resuming = False
        if run.paused != paused:
            run.paused = paused
            self._pursue(run)
            run.report(ActionStatus.PAUSED if paused else ActionStatus.RUNNING)
            self._conditions.check()

    def _show_unpausable(self, run: _Run) -> None:
        run.cannot_pause = True
        if run.wanted == action_pb2.kPause:
            run.wanted = None
        run.wake.set()
        self._conditions.check()

    def _pause(self, pause: bool) -> None:
        for run in self._runs.values():
            run.cannot_pause = False
            self._want(run, action_pb2.kPause if pause else action_pb2.kResume)

    def _is_paused(self) -> bool:
        return all(run.stands or run.cannot_pause for run in self._runs.values())

    def _snapshot(self, info: RobotInfo) -> None:
        """Find out the states of the actions after a reconnect."""
        for run in self._runs.values():
            self._inquire(run)

    def _link_changed(self, state: LinkState) -> None:
        for run in self._runs.values():
            run.wake.set()

    def _inquire(self, run: _Run) -> None:
        """Ask the robot about an action, until it answers or the link is lost."""
        if run.inquiry is None or run.inquiry.done():
            run.inquiry = self._tasks.start(self._poll(run))

    async def _poll(self, run: _Run) -> None:
        def found(answer: Answer) -> None:
            reports = answer.body.fbs if answer.ok and isinstance(answer.body, Feedbacks) else ()
            mine = [each for each in reports if each.action == full_name(run.command)]
            if mine:
                self._judge(run, mine[-1])
            is_known = run.accepted or run.heard
            if not mine or not is_known:
                run.unknown = True
                run.end("the link was lost, and the robot does not tell how it ended")

        while not run.ended.done():
            try:
                await self._chassis.wait_ready(_READY_TIMEOUT)  # the snapshot comes shortly before
                await self._chassis.request(self._requests.empty(Feedbacks), tap=found)
            except LinkError as error:
                _LOG.debug("reports on %s: %s", run.name, error)
            else:
                return
            if self._chassis.state is not LinkState.READY:
                return  # asked again after a reconnect
            await asyncio.sleep(_ASK_EVERY)
