"""Execution of the robot's own actions: steps, lifts and the like."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link import (
    Answer,
    ChassisClient,
    ConnectionLostError,
    LinkError,
    LinkState,
    NotConnectedError,
    RequestTimeoutError,
)
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.ros import action_pb2, ros_pack_pb2
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction, Feedback, Feedbacks
from woosh_robot_agent.protos import full_name
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.vda5050.actions.conditions import Conditions
from woosh_robot_agent.vda5050.actions.errors import ActionFailedError
from woosh_robot_agent.vda5050.actions.pause import Pause
from woosh_robot_agent.vda5050.model.state import ActionStatus

_LOG = logging.getLogger(__name__)
_REPEAT_AFTER = 3.0
"""Time after which a pause or a cancel is repeated if it had no effect, in seconds."""
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


class _Run:
    """An action that the robot executes.

    Args:
        command: the command, without its `action`.
        report: called with each new status: it runs, or is paused.

    Attributes:
        accepted: the robot has accepted the start.
        heard: the robot has reported that it executes the action.
        paused: the robot has reported that the action is paused.
        cannot_pause: the robot could not pause it.
        wanted: what the robot must do with it; None for nothing.
        ended: the reason of the failure, or an empty text.
        result: text of the last report.
    """

    def __init__(self, command: Message, report: Callable[[ActionStatus], None]) -> None:
        self.command = command
        self.report = report
        self.accepted = False
        self.heard = False
        self.paused = False
        self.cannot_pause = False
        self.wanted: action_pb2.ControlAction | None = None
        self.ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self.result = ""

    @property
    def obeys(self) -> bool:
        """True if the robot has done what is wanted."""
        is_paused = self.paused or self.cannot_pause
        return self.ended.done() or (self.wanted == action_pb2.kPause and is_paused)

    @property
    def name(self) -> str:
        """Name of the command, for texts."""
        return self.command.DESCRIPTOR.name

    def call(self, action: action_pb2.ControlAction) -> CallAction:
        """Return the request that starts, pauses, resumes or cancels the action."""
        call = CallAction()
        part: Any = getattr(call, _FIELDS[full_name(self.command)])
        part.CopyFrom(self.command)
        part.action = action
        return call

    def end(self, reason: str) -> None:
        """End the run, with the reason why it failed; empty if it succeeded."""
        if not self.ended.done():
            self.ended.set_result(reason)


class RobotCalls:
    """Executes the robot's own actions, one of each kind at a time.

    No start is repeated. If its answer is lost, the reports of the robot decide.

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
        self._tasks: set[asyncio.Task[None]] = set()
        chassis.subscribe(Feedbacks, self._reported)
        chassis.on_snapshot(self._snapshot)
        chassis.on_robot_changed(self._robot_changed)
        pause.join(self._pause, self._is_paused)

    @property
    def busy(self) -> bool:
        """True while the robot executes an action."""
        return bool(self._runs)

    async def perform(self, command: Message, report: Callable[[ActionStatus], None]) -> str:
        """Execute an action, and return the text of its last report.

        When cancelled, cancel the action at the robot.

        Args:
            command: the command, a member of CallAction.
            report: called when the robot accepts, pauses or resumes the action.

        Raises:
            ActionFailedError: the action failed.
        """
        name = full_name(command)
        if name in self._runs:
            raise ActionFailedError(f"the robot executes another {command.DESCRIPTOR.name} already")
        run = self._runs[name] = _Run(command, report)
        try:
            await self._start(run)
            reason = await asyncio.shield(run.ended)
        except asyncio.CancelledError:
            if not self._closing:
                await self._insist(run, action_pb2.kCancel)
            raise
        finally:
            del self._runs[name]
        if reason:
            raise ActionFailedError(reason)
        return run.result

    async def close(self) -> None:
        """Stop waiting for answers; the robot goes on with its actions."""
        self._closing = True
        for each in self._tasks:
            each.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

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
                self._spawn(self._poll(run))
        except LinkError as error:
            raise ActionFailedError(f"{run.name} was not sent: {error}") from None
        else:
            if not answer.ok:
                raise ActionFailedError(f"the robot refused {run.name}: {answer.msg}")

    async def _insist(self, run: _Run, action: action_pb2.ControlAction) -> None:
        """Send an order to an action until it has obeyed, or another order is wanted."""
        run.wanted = action
        while run.wanted == action and not run.obeys:
            try:
                await self._chassis.wait_ready(_REPEAT_AFTER)
            except LinkError:
                continue
            try:
                answer = await self._gate.request(run.call(action))
            except NotConnectedError:
                continue
            except LinkError as error:
                _LOG.warning("an order to %s was not answered: %s", run.name, error)
            else:
                if not answer.ok:
                    _LOG.info("the robot refused an order to %s: %s", run.name, answer.msg)
                    if action == action_pb2.kPause:
                        self._show_unpausable(run)
            if action == action_pb2.kResume:
                return  # it moves the robot, so it is sent once
            await asyncio.wait({run.ended}, timeout=_REPEAT_AFTER)
            if action == action_pb2.kCancel and not run.ended.done():
                await self._poll(run)

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
        if run.paused != paused:
            run.paused = paused
            run.report(ActionStatus.PAUSED if paused else ActionStatus.RUNNING)
            self._conditions.check()

    def _show_unpausable(self, run: _Run) -> None:
        run.cannot_pause = True
        self._conditions.check()

    def _pause(self, pause: bool) -> None:
        for run in self._runs.values():
            if run.wanted == action_pb2.kCancel:
                continue
            run.cannot_pause = False
            if not pause:
                self._show_paused(run, False)  # so that a pause right after it is sent
            self._spawn(self._insist(run, action_pb2.kPause if pause else action_pb2.kResume))

    def _is_paused(self) -> bool:
        return all(run.paused or run.cannot_pause for run in self._runs.values())

    def _snapshot(self, info: RobotInfo) -> None:
        """Find out what became of the actions while there was no link."""
        for run in self._runs.values():
            self._spawn(self._poll(run))

    async def _poll(self, run: _Run) -> None:
        def found(answer: Answer) -> None:
            reports = answer.body.fbs if answer.ok and isinstance(answer.body, Feedbacks) else ()
            mine = [each for each in reports if each.action == full_name(run.command)]
            if mine:
                self._judge(run, mine[-1])
            is_known = run.accepted or run.heard
            if not mine or not is_known:
                run.end("the link was lost meanwhile, and the robot does not tell how it ended")

        try:
            await self._chassis.wait_ready(_READY_TIMEOUT)  # a snapshot comes shortly before
            await self._chassis.request(self._requests.empty(Feedbacks), tap=found)
        except LinkError as error:
            _LOG.debug("reports on %s: %s", run.name, error)  # asked again after a reconnect

    def _robot_changed(self) -> None:
        for run in self._runs.values():
            run.end("another robot answers now")

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        running = asyncio.get_running_loop().create_task(work, name="vda5050 call")
        self._tasks.add(running)
        running.add_done_callback(self._tasks.discard)
