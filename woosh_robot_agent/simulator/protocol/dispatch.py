"""Dispatches each request to its handler."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from google.protobuf.message import Message

from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol import (
    action_commands,  # noqa: F401 - adds its handlers
    map_commands,  # noqa: F401 - adds its handlers
    mark_commands,  # noqa: F401 - adds its handlers
    state_commands,  # noqa: F401 - adds its handlers
    task_commands,  # noqa: F401 - adds its handlers
)
from woosh_robot_agent.simulator.protocol.handlers import COMMANDS, QUERIES, Handler, non_finite
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.status_codes import Code

_LOG = logging.getLogger(__name__)

SUCCESS = "Request succeed"
"""Text of the answer to an executed command, as the real robot words it."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a request.

    Attributes:
        type: full protobuf name of the body; without a body, the one of the request, or `error` if
            no request has its type.
        body: body, None for an empty body.
        ok: True if the request was executed, or merely has no effect and gets an explanation.
        msg: text for people; the reason if the request was refused; empty for most queries.
        code: status code that follows the answer, None if there is none.
    """

    type: str
    body: Message | None
    ok: bool
    msg: str
    code: Code | None = None


HANDLERS: dict[str, Handler] = {**QUERIES, **COMMANDS}
"""Handlers by the full protobuf name of the request."""


def dispatch(chassis: Chassis, request: Message) -> Answer:
    """Execute or refuse a request, whose type must be in `HANDLERS`, and return the answer."""
    name = request.DESCRIPTOR.full_name
    text = chassis.profile.refusals.always.get(name)  # this robot model refuses the type
    if text is not None:
        return Answer(name, None, ok=False, msg=text)
    try:
        path = non_finite(request)
        if path:
            raise RefusedError(f"{path} is not a finite number")
        if name in COMMANDS:
            chassis.auto_tasks.postpone()
        result = HANDLERS[name](chassis, request)
    except RefusedError as error:
        return _answer_refused(chassis, name, error)
    if isinstance(result, str):
        explained = chassis.profile.refusals.explained
        return Answer(name, None, ok=True, msg=result if explained else SUCCESS)
    msg = "" if name in QUERIES else SUCCESS
    if result is None:
        return Answer(name, None, ok=True, msg=msg)
    return Answer(result.DESCRIPTOR.full_name, result, ok=True, msg=msg)


def _answer_refused(chassis: Chassis, name: str, error: RefusedError) -> Answer:
    """Return the answer to a request that its handler has refused, worded as in the profile."""
    refusal, profile = error.refusal, chassis.profile.refusals
    _LOG.info("%s is refused: %s", name, error)
    if profile.explained:
        return Answer(name, None, ok=refusal.harmless, msg=str(error))
    words = profile.texts.get(name, refusal.words)
    code = refusal.code if profile.codes else None
    return Answer(name, None, ok=False, msg=words, code=code)


def refusal_answer(name: str, reason: str) -> Answer:
    """Return the answer to a request of the type `name` that is refused without a handler."""
    return Answer(name if name in HANDLERS else "error", None, ok=False, msg=reason)
