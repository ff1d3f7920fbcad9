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
    """A report under the name of a goal."""

    message: Message
    """The report as the chassis sent it."""
    outcome: Outcome | None
    """The outcome that it reports, None if the goal goes on."""


@dataclass(frozen=True)
class Findings:
    """What the chassis told when it was polled."""

    reports: Sequence[Report] = ()
    """Reports under the name of the goal."""
    unknown: str | None = None
    """Why the goal counts as ended, if the chassis does not know it any more."""


@dataclass(frozen=True)
class Start:
    """A request that starts the goal."""

    message: Message


@dataclass(frozen=True)
class Order:
    """A request about the goal that runs already, such as a pause; its answer ends this goal."""

    message: Message
    result: Callable[[str], Message]
    """Makes the result from the text of the answer."""


class GoalKind(Protocol):
    """What differs between the kinds of goal; there is one object for each goal."""

    @property
    def name(self) -> str:
        """Name under which the chassis reports on the goal; earlier goals may have had it."""

    @property
    def attribution(self) -> Attribution:
        """Decides which reports under the name are on this goal."""

    def request(self) -> Start | Order:
        """Return the request that the goal asks for.

        Raises:
            BadFieldError: the robot must not get a value in it.
        """

    def cancel_request(self) -> Message:
        """Return the request that cancels the goal; only after `request`."""

    def read(self, message: Message) -> Iterable[Report]:
        """Return the reports in `message` that are under the name of the goal."""

    async def poll(self) -> Findings:
        """Ask the chassis for the state of the goal.

        Raises:
            LinkError: the chassis gave no answer.
        """

    def failure(self, reason: str) -> Message:
        """Return the result of the goal if it fails for `reason`."""
