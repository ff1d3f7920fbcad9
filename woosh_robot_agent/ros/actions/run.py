"""Execution of a goal in the link thread: send it, follow the chassis's reports, end it."""

from __future__ import annotations

import asyncio
import logging
import math
from collections import deque
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert import BadFieldError
from woosh_robot_agent.link import (
    Answer,
    ConnectionLostError,
    LinkError,
    LinkState,
    RequestTimeoutError,
)
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.motion import Sender
from woosh_robot_agent.robot.code_log import GOAL_CANCEL
from woosh_robot_agent.ros.actions.giving_up import Cancellation, GiveUp
from woosh_robot_agent.ros.actions.goal import (
    TRANSITIONS,
    CancelRequested,
    Cause,
    End,
    Event,
    GivenUp,
    GoalClient,
    GoalKind,
    GoalTiming,
    LinkChanged,
    Order,
    Outcome,
    Phase,
    PollFailed,
    PollResult,
    Pushed,
    Report,
    StartAnswered,
    Step,
    Tick,
)
from woosh_robot_agent.ros.context import RobotContext

_LOG = logging.getLogger(__name__)
_CHECK_PERIOD = 0.1
"""Period of the check whether newer goals are to be cancelled, in seconds."""

# Texts of the results of aborted goals
REPLACED = "replaced by a newer goal that the chassis accepted"
STOPPING = "the agent is stopping; the robot may still be executing the goal"
_DISPLACED = "the chassis stopped executing the goal, but did not report how it ended"
_CANCEL_REFUSED = (
    "the chassis refused the cancel, and its answers do not mention the goal; the robot may still "
    "be executing it"
)
_NOTHING_CANCELLED = "the chassis accepted the cancel, but reported no end: nothing was running"
_NO_REASON = "the chassis refused the goal without giving a reason"


@dataclass(frozen=True)
class GoalContext(RobotContext):
    """Objects shared by the goals of one action; used in the link thread only."""

    open_goals: OpenGoals
    """The open goals of the action, and of other actions if their goals replace each other."""
    timing: Callable[[], GoalTiming]
    """Returns the timing of a goal that starts now."""
    to_proto: Callable[[Any], Message]
    """Converts the command of a goal, as its client gave it, to a message for the chassis."""
    explain: Callable[[str], Awaitable[str]]
    """Returns why the chassis has just refused a request, given its type; empty if unknown."""


class _RefusedError(Exception):
    """The chassis refused the goal; the text is the text of its answer."""


class GoalRun:
    """One goal, from its acceptance by the action server to its end.

    The queue of events has at most one reader: `_follow` for a goal that starts something, or
    `_next_cancel` for an order that succeeds only if a cancel is reported. `_follow` sends requests
    in separate tasks, so handling an event never waits for an answer.

    Args:
        client: gets the reports and the end.
    """

    def __init__(self, client: GoalClient, kind: GoalKind, context: GoalContext) -> None:
        loop = asyncio.get_running_loop()
        self.name = kind.name
        """Name under which the chassis reports on the goal."""
        self.is_cancel_requested = False
        """True once the client has requested a cancel, even if that is not handled yet."""
        self.phase = Phase.NEW
        """Phase of the goal; only `_advance` changes it."""
        self.accepted: asyncio.Future[bool] = loop.create_future()
        """True once the chassis has accepted the goal, False if it never will."""
        self._client = client
        self._kind = kind
        self._context = context
        self._sender = Sender(published=client.published)
        self._timing = context.timing()
        self._clock = loop.time
        self._events: asyncio.Queue[Event] = asyncio.Queue()
        """Events that are not handled yet, oldest first."""
        self._attribution = kind.attribution
        self._last_report: Message | None = None
        """The last report on this goal."""
        self._feedback_times = deque([-math.inf, -math.inf], maxlen=2)
        """Loop times of the last two pieces of feedback, oldest first; `result_delay` counts from
        the older one."""
        self._give_up = GiveUp(self._timing, self._clock)
        self._cancellation = Cancellation(
            kind.name,
            send=lambda: context.gate.request(
                kind.cancel_request(), urgent=True, sender=Sender(GOAL_CANCEL)
            ),
            is_replaced=lambda: context.open_goals.newer_accepted(self),
            on_accepted=self._give_up.cancel_accepted,
            on_refused=self._cancel_refused,
            has_begun=lambda: self._attribution.has_report,
        )
        self._is_displaced = False
        """True if a push after the last report shows that the chassis no longer executes this
        goal."""
        self._possible_cancel: Message | None = None
        """A report that may be the cancel of this goal, or repeat that of an earlier one."""
        self._next_poll = 0.0
        """Loop time of the next poll."""
        self._starting: asyncio.Task[None] | None = None
        """Task that sends the start request."""
        self._polling: asyncio.Task[None] | None = None
        """Task of the last poll; None before the first one."""

    @property
    def was_accepted(self) -> bool | None:
        """The result of `accepted`; None while it is not decided."""
        return self.accepted.result() if self.accepted.done() else None

    def post(self, event: Event) -> None:
        """Queue an event for the goal; in the link thread."""
        # set here, so that it also applies to reports that are already queued
        if isinstance(event, CancelRequested):
            self.is_cancel_requested = True
        self._events.put_nowait(event)

    async def run(self) -> None:
        """Run the goal, which must be among the open ones; it has ended when this returns."""
        try:
            end = await self._send()
        except BadFieldError as error:
            end = self._aborted(f"{error.below('arg')}; nothing was sent")
        except asyncio.CancelledError:
            self.abort(STOPPING)
            raise
        except Exception as error:
            _LOG.exception("%s failed", self.name)
            end = self._aborted(f"the agent failed: {error!r}; please report this")
        finally:
            self._advance(Step.END)
            self._context.open_goals.remove(self)
            self._cancellation.stop()
            for task in (self._starting, self._polling):
                if task is not None:
                    task.cancel()
        # rclpy's client drops the feedback that it has not read when the result arrives
        delay = self._feedback_times[0] + self._timing.result_delay - self._clock()
        try:
            if delay > 0:
                await asyncio.sleep(delay)
        finally:
            self._client.finish(end)

    def abort(self, reason: str) -> None:
        """Report the goal to the client as aborted, in any phase."""
        self._client.finish(self._aborted(reason))

    def _aborted(self, reason: str, cause: Cause = Cause.AGENT) -> End:
        return End(Outcome.ABORTED, self._kind.failure(reason), cause)

    def _aborted_if(self, reason: str | None) -> End | None:
        return None if reason is None else self._aborted(reason)

    # Phases

    def _advance(self, step: Step) -> None:
        """Enter the phase that follows `step`, and set `accepted` once it is decided.

        If the chassis has accepted the goal, also tell older goals, and send a pending cancel.
        """
        before = self.phase
        self.phase = TRANSITIONS.get((before, step), before)
        if self.accepted.done():
            return
        if self.phase.accepted:
            self.accepted.set_result(True)
            self._context.open_goals.replace_older(self)
            self._cancellation.send_soon()
        elif self.phase in (Phase.ORDERING, Phase.ENDED):
            self.accepted.set_result(False)

    async def _send(self) -> End:
        """Send the goal and return its end. A refusal is an end, too, with its explanation."""
        try:
            request = self._kind.request()
            if isinstance(request, Order):
                return await self._send_order(request)
            return await self._follow(request)
        except _RefusedError as error:
            # decides `accepted` now: older goals wait for it, and the explanation takes a while
            self._advance(Step.END)
            reason = await self._context.explain(self._kind.request_type)
            text = f"{error} ({reason})" if reason else str(error)
            return self._aborted(text, Cause.REFUSAL)

    async def _send_order(self, order: Order) -> End:
        """Send an order. Reports still belong to the goal that is already running.

        Raises:
            _RefusedError: the chassis refused the order.
        """
        self._advance(Step.ORDER_SENT)
        try:
            answer = await self._context.gate.request(order.message, sender=self._sender)
        except ConnectionLostError as error:
            return self._aborted(
                f"the link was lost before the chassis answered: {error}; whether the order took "
                "effect is not known"
            )
        except LinkError as error:
            return self._aborted(str(error))
        if not answer.ok:
            raise _RefusedError(answer.msg or _NO_REASON)
        if order.needs_cancel_report and not await self._cancel_reported():
            return self._aborted(_NOTHING_CANCELLED)
        return End(Outcome.SUCCEEDED, order.result(answer.msg), Cause.REPORT)

    async def _cancel_reported(self) -> bool:
        """Return True if the chassis has reported a cancel since the order, or does so soon."""
        try:
            await run_with_timeout(self._timing.cancel_report_timeout, self._next_cancel())
        except TimeoutError:
            return False
        return True

    async def _next_cancel(self) -> None:
        """Wait until the chassis reports a cancel."""
        while True:
            event = await self._events.get()
            if isinstance(event, Pushed) and any(
                report.outcome is Outcome.CANCELED for report in self._kind.read(event.message)
            ):
                return

    async def _follow(self, start: Message) -> End:
        """Send the start request and handle events until one of them ends the goal."""
        loop = asyncio.get_running_loop()
        self._starting = loop.create_task(self._send_start(start), name="goal: start")
        self._advance(Step.START_SENT)
        self._next_poll = self._clock() + self._timing.poll_period
        while True:
            wake_up = min(self._give_up.deadline, self._next_poll)
            timer = loop.call_at(wake_up, self.post, Tick())
            try:
                event = await self._events.get()
            finally:
                timer.cancel()
            end = self._handle(event)
            if end is not None:
                if isinstance(event, PollResult):
                    self._kind.note_polled_end(end)
                return await self._end_for_client(end)

    async def _end_for_client(self, end: End) -> End:
        """Return the end to send to the client: an unrequested cancel becomes an abort."""
        if end.outcome is not Outcome.CANCELED or self.is_cancel_requested:
            return end
        if await self._context.open_goals.newer_accepted(self):
            return self._aborted(REPLACED)
        return End(Outcome.ABORTED, end.result, Cause.AGENT)

    # Events

    def _handle(self, event: Event) -> End | None:
        """Handle an event; return the end of the goal if the event ends it."""
        match event:
            case Pushed(message):
                return self._pushed(message)
            case StartAnswered(answer):
                return self._start_answered(answer)
            case PollResult():
                return self._polled(event)
            case PollFailed():
                return self._poll_failed(event)
            case LinkChanged(ready):
                self._link_changed(ready)
            case CancelRequested():
                self._cancellation.pending = True
                # otherwise the cancel is sent with the acceptance, or the next report on the goal
                if self.phase.accepted and not self._is_displaced:
                    self._cancellation.send_soon()
            case GivenUp(reason):
                return self._aborted(reason)
            case Tick():
                return self._tick()
        return None

    def _pushed(self, message: Message) -> End | None:
        end = self._take_reports(
            report for report in self._kind.read(message) if not self._set_aside(report)
        )
        if end is None and self._attribution.has_report and self._kind.is_displaced(message):
            self._is_displaced = True
            self._poll_soon()  # the report of the end may have been lost
        return end

    def _take_reports(self, reports: Iterable[Report]) -> End | None:
        """Publish the reports on this goal as feedback; return its end if one reports it."""
        for report in reports:
            if not self._attribution.attribute(
                report.outcome, self.phase, cancel_requested=self.is_cancel_requested
            ):
                if report.outcome is not None:
                    self._attribution.note_earlier_end(report.message)
                    self._doubt_end(report)
                continue
            self._last_report = report.message
            # a cancel may have ended only the part before, so this part is cancelled, too
            if report.begins_part and self.is_cancel_requested:
                self._cancellation.pending = True
                self._give_up.part_begun()
            cause = Cause.LATE_REPORT if self._give_up.is_state_unknown else Cause.REPORT
            self._note_report()
            self._feedback_times.append(self._clock())
            self._client.feedback(report.message)
            if report.outcome is not None:
                return End(report.outcome, report.message, cause)
        return None

    def _set_aside(self, report: Report) -> bool:
        """Set a push aside if it may just repeat the end of an earlier goal; return True then."""
        may_be_repeated = self._attribution.repeats_previous(report.message, report.outcome)
        if may_be_repeated:
            self._doubt_end(report)
        return may_be_repeated

    def _doubt_end(self, report: Report) -> None:
        """If this goal is being cancelled, let a poll decide whether an end is its own."""
        if self.is_cancel_requested and self.phase.accepted:
            self._poll_once_begun()
            if report.outcome is Outcome.CANCELED:
                self._possible_cancel = report.message

    def _note_report(self) -> None:
        """Note a report on this goal, even an old one that the answer to a poll repeats."""
        self._give_up.report()
        self._is_displaced = False
        self._next_poll = self._clock() + self._timing.poll_period
        self._advance(Step.REPORT)  # matters if the answer is lost, or still on its way
        if self._context.chassis.state is LinkState.READY:
            self._cancellation.send_soon()  # retry a cancel that was not answered

    def _start_answered(self, answer: Answer | Exception) -> End | None:
        """Handle the answer to the start, or the error in its place.

        Return the end of the goal if nothing was sent; None if the goal goes on, also without an
        answer.

        Raises:
            _RefusedError: the chassis refused the start.
            Exception: `answer` itself, if it is an unexpected error.
        """
        match answer:
            case Answer(ok=True):
                self._advance(Step.ACCEPTED)
            case Answer():
                raise _RefusedError(answer.msg or _NO_REASON)
            case RequestTimeoutError() | ConnectionLostError():
                self._advance(Step.ANSWER_LOST)
                _LOG.warning(
                    "no answer to the start of %s; polling the chassis for its state: %s",
                    self.name,
                    answer,
                )
                if not self._attribution.has_report:
                    self._give_up.answer_lost(answer)
                self._poll_soon()
            case LinkError():  # nothing was sent
                return self._aborted(str(answer))
            case _:  # unexpected; `run` logs it and aborts the goal
                raise answer
        return None

    def _link_changed(self, ready: bool) -> None:
        if ready:
            self._give_up.link_restored()
            self._poll_soon()
        else:
            self._give_up.link_lost(self._context.chassis.last_error or "it was closed")

    def _tick(self) -> End | None:
        end = self._aborted_if(self._give_up.overdue())
        if end is None and self._clock() >= self._next_poll:
            self._poll_soon()
        return end

    # Polls

    def _cancel_refused(self) -> None:
        """After a refused cancel, poll the goal: perhaps it has ended, and the report was lost."""
        if self._attribution.has_report:
            self._give_up.is_cancel_refused = True
            self._poll_soon()
        else:
            self._poll_once_begun()

    def _poll_once_begun(self) -> None:
        """Poll the state of the goal at the time when it must have begun.

        Until then, the answer may have the end of an earlier goal.
        """
        begins = self._clock() + self._timing.cancel_report_timeout
        self._next_poll = min(self._next_poll, begins)
        self.post(Tick())  # wakes `_follow`, so that it waits for the new time of the poll

    def _poll_soon(self) -> None:
        """Poll the state of the goal if that is possible now, and schedule the next poll."""
        self._schedule_poll()
        # before the start is answered, a poll may return the state of an earlier goal
        can_poll = self.phase.start_is_over and self._context.chassis.state is LinkState.READY
        if can_poll and (self._polling is None or self._polling.done()):
            loop = asyncio.get_running_loop()
            self._polling = loop.create_task(self._poll(), name="goal: poll")

    def _schedule_poll(self) -> None:
        period = self._timing.poll_period
        if self._give_up.is_state_unknown or self._cancellation.pending or self._is_displaced:
            period *= self._timing.unknown_state_poll_factor
        self._next_poll = self._clock() + period

    def _polled(self, result: PollResult) -> End | None:
        """Handle the answer to a poll; return the end that it reports, or that of giving up."""
        for report in result.reports:
            if report.message == self._last_report:
                if report.outcome is not None:
                    # the last task of a set: its push told only the end of the task, but the poll
                    # tells the end of the set
                    return End(report.outcome, report.message, Cause.REPORT)
                self._note_report()
            elif self._attribution.admit_polled(report.message, report.outcome, self.phase):
                end = self._take_reports([report])
                if end is not None:
                    return end
        if not result.reports and (end := self._possible_cancel_as_end()):
            return end
        why_unknown = result.unknown
        # the answer does not tell, but a push has shown that the chassis does not execute this goal
        if why_unknown is None and self._is_displaced:
            why_unknown = _DISPLACED
        elif why_unknown is None and self._give_up.is_cancel_refused and not result.reports:
            why_unknown = _CANCEL_REFUSED
        has_report = self._attribution.has_report
        # until the goal is accepted, its start request may still be on its way
        if why_unknown is None or not self.phase.accepted:
            return self._aborted_if(self._give_up.poll_answered(has_report))
        end = self._aborted_if(self._give_up.poll_unknown(why_unknown, has_report))
        if end is None:
            self._schedule_poll()  # sooner than planned, because the state is unknown now
        return end

    def _poll_failed(self, failed: PollFailed) -> End | None:
        """Handle a poll without an answer; return the end if it is time to give up.

        A poll that was not sent, or was cut off by a loss of the link, counts for nothing.
        """
        if failed.is_silent:
            self._give_up.chassis_silent(failed.error)
        elif isinstance(failed.error, RequestTimeoutError):
            end = self._possible_cancel_as_end()
            return end or self._aborted_if(self._give_up.poll_fruitless(str(failed.error)))
        return None

    def _possible_cancel_as_end(self) -> End | None:
        """Return `_possible_cancel` as the end of this goal; None if there is no such cancel.

        Called when a poll has not told whether this goal was cancelled, or an earlier one. Returns
        None, too, if a report shows that this goal has begun, and while its state is unknown.
        """
        has_begun = self._attribution.has_report
        if self._possible_cancel is None or has_begun or self._give_up.is_state_unknown:
            return None
        return End(Outcome.CANCELED, self._possible_cancel, Cause.REPORT)

    # Tasks

    async def _send_start(self, message: Message) -> None:
        try:
            await self._context.gate.request(
                message,
                # gets the answer in order with the reports
                tap=lambda answer: self.post(StartAnswered(answer)),
                sender=self._sender,
            )
        except Exception as error:
            self.post(StartAnswered(error))

    async def _poll(self) -> None:
        stats = self._context.chassis.stats
        received = stats.rx
        try:
            await self._kind.poll(self.post)
        except LinkError as error:
            _LOG.debug("cannot poll the chassis for the state of %s: %s", self.name, error)
            timed_out = isinstance(error, RequestTimeoutError)
            self.post(PollFailed(error, is_silent=timed_out and stats.rx == received))


class OpenGoals(list[GoalRun]):
    """The goals of one action that have not ended, oldest first; all tasks count as one action.

    The chassis executes only one of these goals at a time.
    """

    def possibly_running(self, name: str) -> int:
        """Return the number of goals of this name that the chassis may be executing."""
        return sum(goal.name == name and goal.was_accepted is not False for goal in self)

    def replace_older(self, goal: GoalRun) -> None:
        """Tell all older goals that the chassis accepted `goal` in their place."""
        for older in self[: self.index(goal)]:
            older.post(GivenUp(REPLACED))

    async def newer_accepted(self, goal: GoalRun) -> bool:
        """Return True if the chassis accepts a newer goal; wait until it has decided.

        If this goal is to be cancelled, do not wait for a newer goal that is to be cancelled, too:
        meanwhile the robot would drive on, and a cancel cannot hit a goal that anybody wants.
        """
        while True:
            newer = self[self.index(goal) + 1 :]
            if any(other.was_accepted for other in newer):
                return True
            pending = [
                other.accepted
                for other in newer
                if other.was_accepted is None
                and not (goal.is_cancel_requested and other.is_cancel_requested)
            ]
            if not pending:
                return False
            # not for ever: a cancel of the newer goals may be requested meanwhile
            await asyncio.wait(pending, timeout=_CHECK_PERIOD, return_when=asyncio.FIRST_COMPLETED)
