"""The events that a goal handles, one at a time."""

from __future__ import annotations

from dataclasses import dataclass

from google.protobuf.message import Message

from woosh_robot_agent.actions.kind import Findings
from woosh_robot_agent.link import Answer, LinkError


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
class Polled:
    """The chassis answered a poll."""

    findings: Findings


@dataclass(frozen=True)
class PollFailed:
    """A poll got no answer."""

    error: LinkError
    silent: bool
    """True if the poll timed out and no frame at all arrived meanwhile."""


@dataclass(frozen=True)
class CancelRequested:
    """The client asked to cancel the goal."""


@dataclass(frozen=True)
class Replaced:
    """The chassis accepted a newer goal, which displaces this one."""


@dataclass(frozen=True)
class GivenUp:
    """The agent does not follow the goal any more."""

    reason: str


@dataclass(frozen=True)
class Tick:
    """A deadline passed, or the next poll is due."""


Event = (
    Pushed
    | LinkChanged
    | StartAnswered
    | Polled
    | PollFailed
    | CancelRequested
    | Replaced
    | GivenUp
    | Tick
)
