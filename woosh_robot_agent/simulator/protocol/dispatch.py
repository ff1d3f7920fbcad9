"""From a request's type to what is done with it."""

from __future__ import annotations

from dataclasses import dataclass

from google.protobuf.message import Message

from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.errors import RefusedError
from woosh_robot_agent.simulator.protocol import (
    action_commands,
    commands,
    queries,
    settings,
    task_commands,
)
from woosh_robot_agent.simulator.protocol.handlers import Handler, non_finite

SUCCESS = "Request succeed"


@dataclass(frozen=True, slots=True)
class Answer:
    """What the chassis answers.

    Attributes:
        type: The protobuf full name of the body, or `error`.
        body: None for an empty one.
        ok: The chassis did what was asked.
        msg: A text for people; if it was refused, why.
    """

    type: str
    body: Message | None
    ok: bool
    msg: str


def _by_name(*tables: dict[type[Message], Handler]) -> dict[str, Handler]:
    return {cls.DESCRIPTOR.full_name: do for table in tables for cls, do in table.items()}


_QUERIES = _by_name(queries.HANDLERS)
_COMMANDS = _by_name(
    commands.HANDLERS, task_commands.HANDLERS, action_commands.HANDLERS, settings.HANDLERS
)

#: What handles each request, by the protobuf full name of the request.
HANDLERS: dict[str, Handler] = {**_QUERIES, **_COMMANDS}


def dispatch(chassis: Chassis, request: Message) -> Answer:
    """Do what `request` asks, which must be of a type in `HANDLERS`."""
    name = request.DESCRIPTOR.full_name
    try:
        number = non_finite(request)
        if number:
            raise RefusedError(f"{number} is not a finite number")
        if name in _COMMANDS:
            chassis.auto_tasks.postpone()
        result = HANDLERS[name](chassis, request)
    except RefusedError as refusal:
        return Answer(name, None, False, str(refusal))
    if isinstance(result, str):
        return Answer(name, None, True, result)
    msg = "" if name in _QUERIES else SUCCESS
    if result is None:
        return Answer(name, None, True, msg)
    return Answer(result.DESCRIPTOR.full_name, result, True, msg)


def refusal(name: str, reason: str) -> Answer:
    """The answer to a request that was not even looked at."""
    return Answer(name if name in HANDLERS else "error", None, False, reason)
