"""Dispatches each request to its handler."""

from __future__ import annotations

from dataclasses import dataclass

from google.protobuf.message import Message

from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.errors import RefusedError
from woosh_robot_agent.simulator.protocol import (
    action_commands,
    drive_commands,
    map_commands,
    queries,
    settings,
    state_commands,
    task_commands,
)
from woosh_robot_agent.simulator.protocol.handlers import Handler, non_finite

SUCCESS = "Request succeed"


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a request.

    Attributes:
        type: Full protobuf name of the body, or `error`.
        body: Body, None for an empty one.
        ok: The request was executed.
        msg: Text for people; the reason if the request was refused.
    """

    type: str
    body: Message | None
    ok: bool
    msg: str


def _by_name(*tables: dict[type[Message], Handler]) -> dict[str, Handler]:
    return {cls.DESCRIPTOR.full_name: do for table in tables for cls, do in table.items()}


_QUERIES = _by_name(queries.HANDLERS)
_COMMANDS = _by_name(
    state_commands.HANDLERS,
    map_commands.HANDLERS,
    drive_commands.HANDLERS,
    task_commands.HANDLERS,
    action_commands.HANDLERS,
    settings.HANDLERS,
)

HANDLERS: dict[str, Handler] = {**_QUERIES, **_COMMANDS}
"""Handlers by the full protobuf name of the request."""


def is_query(name: str) -> bool:
    """Return True if a request, given its full name, only reads values."""
    return name in _QUERIES


def dispatch(chassis: Chassis, request: Message) -> Answer:
    """Execute a request, whose type must be in `HANDLERS`, and return the answer."""
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
    """Return the answer to a request that is refused without calling its handler."""
    return Answer(name if name in HANDLERS else "error", None, False, reason)
