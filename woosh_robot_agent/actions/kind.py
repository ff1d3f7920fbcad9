"""The protocol of a kind of goal: tasks and call actions implement it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from google.protobuf.message import Message

from woosh_robot_agent.actions.attribution import Attribution
from woosh_robot_agent.actions.outcome import Outcome


@dataclass(frozen=True)
class Report:
    """A report with the name of a goal."""

    message: Message
    """The report as the chassis sent it."""
    outcome: Outcome | None
    """The reported outcome; None if the goal is still running."""
    begins_part: bool = False
    """True if the chassis goes on with a further part of the goal, such as the next task of a set.
    A cancel may have ended the part before it only."""


@dataclass(frozen=True)
class Findings:
    """Result of a poll."""

    reports: Sequence[Report] = ()
    """Reports with the name of the goal."""
    unknown: str | None = None
    """Error text if the chassis no longer knows the goal; otherwise None."""


@dataclass(frozen=True)
class Start:
    """A request that starts the goal."""

    message: Message


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
    """The behaviour in which tasks and call actions differ; one object for each goal."""

    @property
    def name(self) -> str:
        """Name under which the chassis reports on the goal; earlier goals may have had it."""

    @property
    def request_type(self) -> str:
        """Protobuf full name of the request, or of the command that it carries."""

    @property
    def attribution(self) -> Attribution:
        """Decides which reports with the name belong to this goal."""

    def request(self) -> Start | Order:
        """Return the request that carries out the goal.

        Raises:
            BadFieldError: a value must not be sent to the robot.
        """

    def cancel_request(self) -> Message:
        """Return the request that cancels the goal; only after `request`."""

    def read(self, message: Message) -> Iterable[Report]:
        """Return the reports in `message` that have the name of the goal."""

    def is_displaced(self, message: Message) -> bool:
        """Return True if `message` shows that the chassis is executing something else, or nothing.

        The end of the goal may have been reported while nobody listened.
        """

    async def poll(self, found: Callable[[Findings], None]) -> None:
        """Ask the chassis for the state of the goal.

        Args:
            found: called once with the result, in order with the pushes.

        Raises:
            LinkError: the chassis gave no answer.
        """

    def failure(self, reason: str) -> Message:
        """Return the result for a goal that failed for `reason`."""
