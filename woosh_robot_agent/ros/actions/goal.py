"""A goal's phases, timing, outcome, reports and events, and the interface of its kind.

A report identifies a task by its id, which clients may reuse, and any other action only by its
type. This id or type is the name of a goal. So a report with the name of a goal may belong to an
earlier goal, even to one of another program. `Attribution` decides to which goal a report belongs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from google.protobuf.message import Message

from woosh_robot_agent.link import Answer, LinkError


class Phase(Enum):
    """The phases of a goal."""

    NEW = "new"
    """The action server accepted the goal. Nothing was sent."""
    STARTING = "starting"
    """The start request was sent. Neither its answer nor a report on the goal has come."""
    REPORTED = "reported"
    """The chassis reported on the goal, but has not answered the start request yet."""
    UNCONFIRMED = "unconfirmed"
    """The answer to the start request was lost. Only a report can confirm the goal."""
    RUNNING = "running"
    """The chassis accepted the goal. No answer is outstanding."""
    ORDERING = "ordering"
    """This goal is an order about the running goal, such as a pause. The order was sent, and this
    goal ends with its answer."""
    ENDED = "ended"
    """The result is known, and does not change any more."""

    @property
    def accepted(self) -> bool:
        """True if the chassis is known to have accepted the goal."""
        return self in (Phase.REPORTED, Phase.RUNNING)

    @property
    def start_is_over(self) -> bool:
        """True while the goal may run, once its start was answered or the answer was lost."""
        return self in (Phase.UNCONFIRMED, Phase.RUNNING)


class Step(Enum):
    """Something that moves a goal to another phase; a handled `Event` may make such a step."""

    START_SENT = "start sent"
    ORDER_SENT = "order sent"
    ACCEPTED = "accepted"
    """The chassis answered that it accepted the goal."""
    ANSWER_LOST = "answer lost"
    REPORT = "report"
    """A report on this goal arrived."""
    END = "end"


TRANSITIONS: Mapping[tuple[Phase, Step], Phase] = {
    (Phase.NEW, Step.START_SENT): Phase.STARTING,
    (Phase.NEW, Step.ORDER_SENT): Phase.ORDERING,
    (Phase.STARTING, Step.ACCEPTED): Phase.RUNNING,
    (Phase.STARTING, Step.REPORT): Phase.REPORTED,
    (Phase.STARTING, Step.ANSWER_LOST): Phase.UNCONFIRMED,
    (Phase.REPORTED, Step.ACCEPTED): Phase.RUNNING,
    (Phase.REPORTED, Step.ANSWER_LOST): Phase.RUNNING,
    (Phase.UNCONFIRMED, Step.REPORT): Phase.RUNNING,
    **{(phase, Step.END): Phase.ENDED for phase in Phase if phase is not Phase.ENDED},
}
"""The phase after a step. A step that is not listed changes nothing."""


class Outcome(Enum):
    """Final state of a goal, as in ROS."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


class Cause(Enum):
    """Who decided how a goal ended."""

    REPORT = "report"
    """The chassis: it reported the end."""
    LATE_REPORT = "late report"
    """The chassis: the end was its first report after a time in which the state of the goal was
    unknown, such as a loss of the link, so it is not known when the goal ended."""
    REFUSAL = "refusal"
    """The chassis: it refused the goal."""
    AGENT = "agent"
    """The agent: the goal could not be sent, was replaced by a newer one, or was given up."""


@dataclass(frozen=True)
class End:
    """Outcome and result of a goal, as sent to the client."""

    outcome: Outcome
    result: Message
    """Usually the chassis's last report on the goal."""
    cause: Cause
    """Who decided the end."""


class GoalClient(Protocol):
    """The client of a goal: a ROS client, or a part of the agent. Used in the link thread."""

    @property
    def published(self) -> float | None:
        """Loop time at which a ROS client sent the goal; None if unknown, or if none sent it."""

    def on_cancel(self, callback: Callable[[], None]) -> None:
        """Call `callback` when the client requests a cancel; at once if it already has."""

    def feedback(self, report: Message, /) -> None:
        """Take a report of the chassis on the goal."""

    def finish(self, end: End) -> None:
        """Take the end of the goal. Only the first call counts."""


@dataclass(frozen=True)
class GoalTiming:
    """Timeouts and poll periods of a goal; all times are in seconds."""

    link_timeout: float = 15.0
    """Maximum wait for a report after the link or the answer to the start request was lost, or the
    chassis fell silent. Set by the parameter `goal_link_timeout`. Most losses on a factory's Wi-Fi
    last 4 to 9 s."""
    poll_period: float = 5.0
    """Time without a report after which the chassis is polled, in case a push was lost."""
    unknown_state_poll_factor: float = 0.2
    """Factor that shortens `poll_period` while the state of the goal is unknown."""
    fruitless_polls: int = 3
    """Number of consecutive polls without an answer, or before the first report on the goal, after
    which the goal may be given up."""
    first_report_timeout: float = 5.0
    """Minimum time over which polls must find a goal unknown that the chassis has accepted and not
    yet reported on. Real robots report 0.5 to 1.2 s after the acceptance."""
    unknown_polls: int = 2
    """Number of consecutive polls that must find the goal unknown to the chassis before it ends."""
    cancel_report_timeout: float = 2.0
    """Maximum wait for the report that something was cancelled, if nothing is known to run. After
    the same time, an accepted goal counts as begun. Real robots show the effect of an order within
    1.2 s."""
    result_delay: float = 0.1
    """Minimum time from the last but one feedback message to the result. rclpy's action client
    reads one feedback message in each turn. When it reads the result, it drops all feedback that it
    has not read."""
    min_cancel_timeout: float = 10.0
    """Lower bound of `cancel_timeout`."""

    @property
    def cancel_timeout(self) -> float:
        """Maximum wait for the end of a goal after an accepted cancel."""
        return max(2 * self.link_timeout, self.min_cancel_timeout)


class Attribution:
    """Decides which reports with the name of a goal belong to that goal.

    Call `attribute` once for each report, in the order of arrival: it remembers its decisions.

    Args:
        predecessors: number of earlier goals with the same name that may still be running.
        inherited: outcomes that an earlier goal may still report. If the first end has one of them,
            it belongs to that goal.
        repeats_ends: True if the chassis may repeat the last reported end, even if it belongs to an
            earlier goal: in the answer to a poll, or in a push.
        previous: the chassis's last report with the name before this goal, if known; only used with
            `repeats_ends`.
    """

    def __init__(
        self,
        predecessors: int = 0,
        inherited: Iterable[Outcome] = (),
        *,
        repeats_ends: bool = False,
        previous: object = None,
    ) -> None:
        self.has_report = False
        """True once a report has been attributed to this goal."""
        self._predecessors = predecessors
        self._inherited = frozenset(inherited)
        self._repeats_ends = repeats_ends
        self._previous = previous
        self._was_polled = False
        """True once a poll's answer has contained an end since this goal was accepted."""

    def attribute(self, outcome: Outcome | None, phase: Phase, *, cancel_requested: bool) -> bool:
        """Decide if a report belongs to this goal; return True if it does.

        Args:
            outcome: reported outcome; None if the goal is still running.
            cancel_requested: True if the client of this goal asked to cancel it.
        """
        if outcome is None:
            is_own = self._attribute_progress(phase)
        else:
            is_own = self._attribute_end(outcome, phase, cancel_requested)
        self.has_report |= is_own
        return is_own

    def admit_polled(self, report: object, outcome: Outcome | None, phase: Phase) -> bool:
        """Decide if a report in a poll's answer is to be passed to `attribute`.

        The chassis may answer a poll with the end of an earlier goal, if that was its last report.
        Therefore an end that is equal to the last report before this goal is rejected:

        - always, while this goal is not accepted. If the last report before is not known, every end
          is rejected.
        - once, after this goal was accepted. In a later poll, an equal end means that this goal has
          ended in the same way.

        Call this once for each report of a poll.

        Args:
            outcome: reported outcome; None if the goal is still running.
        """
        if self.has_report or outcome is None or not self._repeats_ends:
            return True
        previous = self._previous
        if phase.accepted:
            was_polled, self._was_polled = self._was_polled, True
            return was_polled or report != previous
        # without an earlier end to compare with, an end proves nothing
        return previous is not None and report != previous

    def repeats_previous(self, report: object, outcome: Outcome | None) -> bool:
        """Return True if a push may just repeat the end of an earlier goal.

        Pass no such push to `attribute`. If this goal has ended in the same way, a poll tells.
        """
        # with predecessors, an end may be new: each one reports its own, and these may be alike
        if self.has_report or self._predecessors or outcome is None:
            return False
        return self._repeats_ends and report == self._previous

    def note_earlier_end(self, report: object) -> None:
        """Note the end of an earlier goal, as the last report before this goal."""
        self._previous, self._was_polled = report, False

    def _attribute_progress(self, phase: Phase) -> bool:
        """Decide on a report that the goal is running."""
        if self._predecessors and not phase.accepted:
            return False  # an earlier goal may still be running
        if phase.start_is_over:
            # this goal runs, so the earlier goals have ended; a late report may still say that the
            # last of them was cancelled
            self._inherited = frozenset([Outcome.CANCELED] if self._predecessors else [])
        return True

    def _attribute_end(self, outcome: Outcome, phase: Phase, cancel_requested: bool) -> bool:
        """Decide on a report of an end, which may be that of an earlier goal of the same name."""
        inherited, has_predecessor = self._inherited, self._predecessors > 0
        # after this end, no other end of an earlier goal is expected
        if phase.start_is_over or self._predecessors < 2:
            self._inherited = frozenset()
            self._predecessors = 0
        else:  # each earlier goal reports its own end
            self._predecessors -= 1
        if phase.accepted and outcome is Outcome.CANCELED and cancel_requested:
            # until this goal has begun, its cancel may have no effect: then an earlier goal ended
            return self.has_report or not has_predecessor
        if phase is Phase.RUNNING:
            return outcome not in inherited
        # before the answer, this may be the end of an earlier goal; if it is the end of this goal,
        # a later poll finds it
        return not inherited


@dataclass(frozen=True)
class Report:
    """A report with the name of a goal; it may belong to an earlier goal of the same name."""

    message: Message
    """The report as the chassis sent it."""
    outcome: Outcome | None
    """The reported outcome; None if the goal is still running."""
    begins_part: bool = False
    """True if the chassis goes on with a further part of the goal, such as the next task of a set.
    An earlier cancel may have ended only the part before."""


@dataclass(frozen=True)
class PollResult:
    """The chassis's answer when it was asked for the state of a goal.

    If neither attribute is set, the answer tells nothing about the goal.
    """

    reports: Sequence[Report] = ()
    """Reports with the name of the goal."""
    unknown: str | None = None
    """Error text if the chassis no longer knows the goal; otherwise None."""


@dataclass(frozen=True)
class Order:
    """A request whose answer ends the goal: an order such as a pause, or a setting."""

    message: Message
    result: Callable[[str], Message]
    """Makes the result from the text of the answer."""
    needs_cancel_report: bool = False
    """True for a cancel of something that may not be running: it succeeds only if the chassis also
    reports that something was cancelled."""


class GoalKind(Protocol):
    """The part of one goal that depends on its kind: its requests, and the chassis's reports on it.

    The kinds are tasks, sets of tasks and CallAction. Each goal has an object of its own.
    """

    name: str
    """Name under which the chassis reports on the goal; earlier goals may have the same."""
    request_type: str
    """Protobuf full name of the request, or of the command that it carries."""
    attribution: Attribution
    """Decides which reports with the name of this goal belong to it."""

    def request(self) -> Message | Order:
        """Return the request that starts the goal, or an order if the goal is one.

        Raises:
            BadFieldError: a value must not be sent to the robot.
        """

    def cancel_request(self) -> Message:
        """Return the request that cancels the goal; only after `request`."""

    def read(self, message: Message) -> Iterable[Report]:
        """Return the reports in `message` that have the name of the goal."""

    def is_displaced(self, message: Message) -> bool:
        """Return True if `message` shows that the chassis is executing something else, or nothing.

        Then the report of the goal's end may have been lost.
        """

    async def poll(self, on_result: Callable[[PollResult], None]) -> None:
        """Ask the chassis for the state of the goal.

        Args:
            on_result: called once with the result, in order with the pushes.

        Raises:
            LinkError: the chassis gave no answer.
        """

    def note_polled_end(self, end: End) -> None:
        """Tell the gate of an end that a poll has told, and perhaps no push."""

    def failure(self, reason: str) -> Message:
        """Return the result for a goal that failed for `reason`."""


@dataclass(frozen=True)
class Pushed:
    """The chassis pushed a message with reports, possibly on other goals."""

    message: Message


@dataclass(frozen=True)
class LinkChanged:
    """The link became ready, or stopped being ready."""

    ready: bool


@dataclass(frozen=True)
class StartAnswered:
    """The chassis answered the start request, or sending it failed."""

    answer: Answer | Exception


@dataclass(frozen=True)
class PollFailed:
    """A poll got no answer."""

    error: LinkError
    is_silent: bool
    """True if the poll timed out and the chassis sent nothing at all meanwhile."""


@dataclass(frozen=True)
class CancelRequested:
    """The client asked to cancel the goal."""


@dataclass(frozen=True)
class GivenUp:
    """The agent does not follow the goal any more, e.g. because a newer goal has replaced it."""

    reason: str


@dataclass(frozen=True)
class Tick:
    """A deadline passed, or the next poll is due."""


Event = (
    Pushed
    | LinkChanged
    | StartAnswered
    | PollResult
    | PollFailed
    | CancelRequested
    | GivenUp
    | Tick
)
