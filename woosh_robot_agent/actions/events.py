"""What can happen to a goal."""

from __future__ import annotations

from dataclasses import dataclass

from google.protobuf.message import Message

from woosh_robot_agent.actions.server import Outcome
from woosh_robot_agent.link import Answer, LinkError


@dataclass(frozen=True)
class End:
    """How a goal ended, and the chassis's last report on it."""

    outcome: Outcome
    ret: Message


@dataclass(frozen=True)
class Report:
    """A push, or an answer that says the same."""

    message: Message


@dataclass(frozen=True)
class LinkChanged:
    """The link became ready, or is not so any more."""

    ready: bool


@dataclass(frozen=True)
class Answered:
    """The chassis's answer to the start of the goal, or why there is none."""

    answer: Answer | Exception


@dataclass(frozen=True)
class Asked:
    """The chassis was asked how the goal stands; what it knows of it has been posted before this.

    Attributes:
        end: the goal's end, if the chassis does not know it.
        error: why it could not be asked, None if it answered.
        silent: whether nothing at all came from it meanwhile.
    """

    end: End | None
    error: LinkError | None = None
    silent: bool = False


class CancelAsked:
    """The client wants the goal cancelled."""


class Replaced:
    """The chassis took a newer goal of the same action."""


class Tick:
    """Time to look whether the goal has waited long enough."""


Event = Report | LinkChanged | Answered | Asked | CancelAsked | Replaced | Tick
