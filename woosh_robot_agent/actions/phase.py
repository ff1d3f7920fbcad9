"""The phases of a goal and all transitions between them; docs/architecture.md has the diagram."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType


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
    CANCELED_ELSEWHERE = "canceled elsewhere"
    """The chassis cancelled the goal without a request of its client. The goal waits until it is
    known whether a newer goal replaced it."""
    ORDERING = "ordering"
    """An order about the running goal, such as a pause, was sent. The goal ends with the answer."""
    ENDED = "ended"
    """The result is known, and does not change any more."""

    @property
    def accepted(self) -> bool:
        """True if the chassis is known to have accepted the goal."""
        return self in (Phase.REPORTED, Phase.RUNNING, Phase.CANCELED_ELSEWHERE)

    @property
    def answered(self) -> bool:
        """True if the start request was answered, or if the answer is known to be lost."""
        return self in (Phase.UNCONFIRMED, Phase.RUNNING)


class Step(Enum):
    """An event that moves a goal to another phase."""

    START_SENT = "start sent"
    ORDER_SENT = "order sent"
    ACCEPTED = "accepted"
    """The chassis answered that it accepted the goal."""
    ANSWER_LOST = "answer lost"
    REPORT = "report"
    """A report on this goal arrived."""
    UNREQUESTED_CANCEL = "unrequested cancel"
    END = "end"


TRANSITIONS: Mapping[tuple[Phase, Step], Phase] = MappingProxyType(
    {
        (Phase.NEW, Step.START_SENT): Phase.STARTING,
        (Phase.NEW, Step.ORDER_SENT): Phase.ORDERING,
        (Phase.STARTING, Step.ACCEPTED): Phase.RUNNING,
        (Phase.STARTING, Step.REPORT): Phase.REPORTED,
        (Phase.STARTING, Step.ANSWER_LOST): Phase.UNCONFIRMED,
        (Phase.REPORTED, Step.ACCEPTED): Phase.RUNNING,
        (Phase.REPORTED, Step.ANSWER_LOST): Phase.RUNNING,
        (Phase.UNCONFIRMED, Step.REPORT): Phase.RUNNING,
        (Phase.REPORTED, Step.UNREQUESTED_CANCEL): Phase.CANCELED_ELSEWHERE,
        (Phase.RUNNING, Step.UNREQUESTED_CANCEL): Phase.CANCELED_ELSEWHERE,
        **{(phase, Step.END): Phase.ENDED for phase in Phase if phase is not Phase.ENDED},
    }
)
"""The phase after a step. A step that is not listed changes nothing."""
