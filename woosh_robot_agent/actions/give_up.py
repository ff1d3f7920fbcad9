"""Giving up: when to stop waiting for a chassis that tells nothing of a goal."""

from __future__ import annotations

from collections.abc import Callable
from math import inf

from woosh_robot_agent.actions.timing import GoalTiming

_CHECK = "check the robot, and stop it with the `stop` service if necessary"


class GiveUp:
    """Decides when a goal is given up. Three things can end the wait for a report on it.

    - A deadline, while the link is lost, or the answer to the start request is, or the chassis
      sends nothing at all. There is one at a time: a later cause replaces the earlier one.
    - A number of polls in a row without news. They do not count while a deadline is set.
    - An accepted cancel that is followed by no report. It does not count while a deadline is set.

    Args:
        timing: the timeouts.
        clock: returns the time in seconds.
    """

    def __init__(self, timing: GoalTiming, clock: Callable[[], float]) -> None:
        self._timing = timing
        self._clock = clock
        self._deadline: float | None = None
        self._cause = ""
        """Why the deadline was set."""
        self._is_silent = False
        """True if the deadline was set because the chassis sends nothing at all."""
        self._is_link_lost = False
        self._fruitless_polls = 0
        self._fruitless_since = 0.0
        self._cancel_deadline = inf

    @property
    def deadline(self) -> float:
        """Time at which to call `overdue`; infinite if nothing limits the wait."""
        return self._cancel_deadline if self._deadline is None else self._deadline

    @property
    def in_doubt(self) -> bool:
        """True if the state of the goal is not known and a poll may tell it."""
        return self._deadline is not None

    def overdue(self) -> str | None:
        """Return why the goal has to be given up now, None if it has not."""
        if self._clock() < self.deadline:
            return None
        if self._deadline is None:
            return (
                "the chassis accepted the cancel, but no report on the goal came for "
                f"{self._timing.cancel_timeout:g} s; the robot may still be executing it: {_CHECK}"
            )
        return (
            f"{self._cause}, and no report on the goal came for {self._timing.link_timeout:g} s; "
            f"the robot may still be executing it: {_CHECK}"
        )

    # What happens to the goal

    def link_lost(self, error: object) -> None:
        """Limit the wait for the link, and for a report after it."""
        self._is_link_lost = True
        self._limit(f"the link was lost ({error})")

    def link_restored(self) -> None:
        """Limit the wait for a report anew: the chassis can be polled now."""
        self._is_link_lost = False
        self._limit("the link was lost")

    def answer_lost(self, error: object) -> None:
        """Limit the wait for a first report, which would replace the answer."""
        self._limit(f"no answer to the goal: {error}")

    def report(self) -> None:
        """Lift all limits: the chassis reported on the goal, though not its end."""
        if not self._is_link_lost:  # else the report is from before the loss
            self._deadline = None
        self._fruitless_polls = 0
        if self._cancel_deadline < inf:
            self.cancel_accepted()

    def cancel_accepted(self) -> None:
        """Limit the wait for the end that the cancel brings, or for another report."""
        self._cancel_deadline = self._clock() + self._timing.cancel_timeout

    # What comes of a poll

    def poll_met_silence(self, error: object) -> None:
        """Limit the wait for a chassis that sent nothing at all while it was polled."""
        if self._deadline is None:
            self._limit(f"the chassis does not answer ({error})")
            self._is_silent = True

    def poll_unanswered(self, error: object) -> str | None:
        """Count a poll without an answer by a chassis that sends other things.

        Returns:
            Why the goal has to be given up, None if it has not.
        """
        return self._fruitless(str(error))

    def poll_answered(self, heard: bool) -> str | None:
        """Count a poll with an answer; what it tells of the goal has been reported by now.

        Args:
            heard: True if there ever was a report on the goal.

        Returns:
            Why the goal has to be given up, None if it has not.
        """
        if self._is_silent:
            self._is_silent = False
            self._deadline = None
        if not heard:
            return self._fruitless("its answers tell nothing of it")
        if self._deadline is None:
            self._fruitless_polls = 0  # an answer is enough: long steps report seldom
        return None

    def _fruitless(self, reason: str) -> str | None:
        if self._deadline is not None:
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

    def _limit(self, cause: str) -> None:
        self._is_silent = False
        self._cause = cause
        self._deadline = self._clock() + self._timing.link_timeout
