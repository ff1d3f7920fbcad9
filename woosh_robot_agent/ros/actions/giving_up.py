"""Cancel a goal at the chassis, and give up on a goal whose end the chassis does not report."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from math import inf

from woosh_robot_agent.link import Answer, LinkError
from woosh_robot_agent.ros.actions.goal import GoalTiming

_LOG = logging.getLogger(__name__)


@dataclass(eq=False)
class Cancellation:
    """Forwards the cancel requests of a goal's client to the chassis, one at a time.

    A request stays pending if it was not answered, or came to the chassis before the goal began,
    because such a request may have no effect. A pending request is sent again at the next call of
    `send_soon`, or at once if the goal has begun by the time of the answer. It may only be sent
    while the goal is running: the cancel request for a task does not name the task, and could hit
    another one.

    Attributes:
        name: name of the goal, for the log.
        is_replaced: waits until it is known if a newer goal replaced this one; returns True if so.
        has_begun: returns True if the chassis has reported on the goal.
        pending: True if a cancel has to be sent.
    """

    name: str
    send: Callable[[], Awaitable[Answer]]
    is_replaced: Callable[[], Awaitable[bool]]
    on_accepted: Callable[[], None]
    on_refused: Callable[[], None]
    has_begun: Callable[[], bool]
    pending: bool = False
    _task: asyncio.Task[None] | None = None

    def send_soon(self) -> None:
        """Send a pending cancel unless one is in flight. Call it only for an accepted goal."""
        if self.pending and (self._task is None or self._task.done()):
            self._task = asyncio.get_running_loop().create_task(self._run(), name="goal: cancel")

    def stop(self) -> None:
        """Stop sending."""
        if self._task is not None:
            self._task.cancel()

    async def _run(self) -> None:
        """Send the pending cancel, and decide by the answer if it has to be sent again."""
        while self.pending:  # repeat if the client has asked again, or the goal begun, meanwhile
            if await self.is_replaced():
                return  # the cancel would hit the newer goal, and this one is over
            self.pending = False
            is_early = not self.has_begun()
            try:
                answer = await self.send()
            except LinkError as error:
                self.pending = True
                _LOG.warning(
                    "cannot cancel %s, which is still running; trying again when the chassis "
                    "reports on the goal: %s",
                    self.name,
                    error,
                )
                return
            if answer.ok:
                self.on_accepted()
            else:
                if not is_early:  # otherwise there was nothing to cancel yet
                    _LOG.warning(
                        "the chassis refused to cancel %s, which may still be running: %s",
                        self.name,
                        answer.reason,
                    )
                self.on_refused()
            if is_early:  # it may have had no effect
                self.pending = True
                if not self.has_begun():
                    return  # sent again with the first report


_CHECK = "check the robot, and stop it with the `stop` service if necessary"
"""Advice to the user, at the end of the reasons to give up."""


class GiveUp:
    """Decides when to give up on a goal whose end the chassis does not report, by four limits.

    - A deadline, set when the link or the answer to the start request is lost, or when the chassis
      falls silent. There is only one: a later cause replaces an earlier one, except that silence
      replaces nothing.
    - A number of consecutive fruitless polls, over at least `link_timeout`: polls that time out, or
      are answered before the first report on the goal. They do not count while a deadline is set.
    - A number of consecutive polls that found the goal unknown to the chassis, or did not mention
      it after a refused cancel; before the first report, also over at least `first_report_timeout`.
    - A timeout after an accepted cancel. Reports that the goal goes on do not extend it. It is
      ignored while a deadline is set.

    Args:
        clock: returns the time in seconds.
    """

    def __init__(self, timing: GoalTiming, clock: Callable[[], float]) -> None:
        self._timing = timing
        self._clock = clock
        self._deadline: float | None = None
        """Time at which to give up; None while there is no deadline."""
        self._cause = ""
        """Cause of the deadline."""
        self._is_silent = False
        """True if the deadline was set because the chassis sends nothing at all."""
        self._is_link_lost = False
        self._fruitless_polls = 0
        """Number of consecutive polls that timed out, or were answered before the first report."""
        self._fruitless_since = 0.0
        """Time of the first of these polls."""
        self._unknown_polls = 0
        """Number of consecutive polls that found the goal unknown to the chassis."""
        self._unknown_since = 0.0
        """Time of the first of these polls."""
        self._cancel_deadline = inf
        """Time at which the wait after an accepted cancel ends; infinite without such a wait."""
        self.is_cancel_refused = False
        """True if the chassis refused the last cancel, and has not reported on the goal since."""

    @property
    def deadline(self) -> float:
        """Time at which to call `overdue`; infinite if nothing limits the wait."""
        return self._cancel_deadline if self._deadline is None else self._deadline

    @property
    def is_state_unknown(self) -> bool:
        """True if it is unknown whether the chassis still executes the goal; a poll may tell."""
        return self._deadline is not None or self._unknown_polls > 0

    def overdue(self) -> str | None:
        """Return the reason to give up now; None if there is none."""
        if self._clock() < self.deadline:
            return None
        if self._deadline is None:
            return (
                "the chassis accepted the cancel, but the goal did not end within "
                f"{self._timing.cancel_timeout:g} s; the robot may still be executing it: {_CHECK}"
            )
        return (
            f"{self._cause}, and no report on the goal came for {self._timing.link_timeout:g} s; "
            f"the robot may still be executing it: {_CHECK}"
        )

    # Events

    def link_lost(self, error: object) -> None:
        """Start the deadline within which the link must return and a report must come."""
        self._is_link_lost = True
        self._set_deadline(f"the link was lost ({error})")

    def link_restored(self) -> None:
        """Restart the deadline, within which a report must come: polls are possible again."""
        self._is_link_lost = False
        self._set_deadline("the link was lost")

    def answer_lost(self, error: object) -> None:
        """Start the deadline for a first report, which confirms the goal like an answer."""
        self._set_deadline(f"no answer to the goal: {error}")

    def report(self) -> None:
        """Reset all counts: the chassis reported on the goal.

        Clear the deadline, too, unless the link is lost.
        """
        if not self._is_link_lost:  # otherwise the report is from before the loss
            self._deadline = None
        self._fruitless_polls = 0
        self._unknown_polls = 0
        self.is_cancel_refused = False

    def cancel_accepted(self) -> None:
        """Start the timeout for the end of the goal, unless an earlier cancel has started it."""
        self.is_cancel_refused = False
        self._cancel_deadline = min(
            self._cancel_deadline, self._clock() + self._timing.cancel_timeout
        )

    def part_begun(self) -> None:
        """End the timeout of a cancel.

        The chassis has begun the next part of the goal, such as the next task of a set, which needs
        another cancel.
        """
        self._cancel_deadline = inf

    # Results of polls

    def chassis_silent(self, error: object) -> None:
        """Start the deadline: the chassis sent nothing at all while it was polled."""
        if self._deadline is None:
            self._set_deadline(f"the chassis does not answer ({error})")
            self._is_silent = True

    def poll_answered(self, has_report: bool) -> str | None:
        """Count an answered poll. Call it after handling the reports in the answer.

        Args:
            has_report: True if any report on the goal has arrived since its start.

        Returns:
            The reason to give up now; None if there is none.
        """
        self._end_silence()
        self._unknown_polls = 0
        if not has_report:
            return self.poll_fruitless("its answers do not mention it")
        if self._deadline is None:
            self._fruitless_polls = 0  # an answer suffices: reports are rare during long steps
        return None

    def poll_unknown(self, reason: str, has_report: bool) -> str | None:
        """Count a poll that found an accepted goal unknown to the chassis.

        One such poll is no proof: the first report on a goal comes some time after its acceptance,
        and may be on its way.

        Args:
            reason: what the chassis said.
            has_report: True if any report on the goal has arrived since its start.

        Returns:
            The reason to give up now; None if there is none.
        """
        self._end_silence()
        now = self._clock()
        if not self._unknown_polls:
            self._unknown_since = now
        self._unknown_polls += 1
        if self._unknown_polls < self._timing.unknown_polls:
            return None
        if not has_report and now - self._unknown_since < self._timing.first_report_timeout:
            return None
        return reason

    def poll_fruitless(self, reason: str) -> str | None:
        """Count a fruitless poll, e.g. one that timed out although other frames arrived.

        Args:
            reason: why the poll was fruitless.

        Returns:
            The reason to give up now; None if there is none.
        """
        if self._deadline is not None:  # the deadline decides; see `overdue`
            return None
        now = self._clock()
        if not self._fruitless_polls:
            self._fruitless_since = now
        self._fruitless_polls += 1
        lasted = now - self._fruitless_since
        if (
            self._fruitless_polls < self._timing.fruitless_polls
            or lasted < self._timing.link_timeout
        ):
            return None
        return (
            f"the chassis accepted the goal, but {self._fruitless_polls} polls in a row brought no "
            f"report on it ({reason}); the robot may still be executing it: {_CHECK}"
        )

    def _end_silence(self) -> None:
        """Clear the deadline if it was set because the chassis sent nothing at all."""
        if self._is_silent:
            self._is_silent = False
            self._deadline = None

    def _set_deadline(self, cause: str) -> None:
        self._is_silent = False
        self._cause = cause
        self._deadline = self._clock() + self._timing.link_timeout
