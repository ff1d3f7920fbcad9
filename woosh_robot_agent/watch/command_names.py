"""Names of commands, as the table of endpoints has them."""

from __future__ import annotations

from woosh_robot_agent.endpoints import ACTIONS, COMMANDS
from woosh_robot_agent.motion import AnsweredCommand
from woosh_robot_agent.refusals import type_of

_NAMES = {
    **{command.request: command.name for command in reversed(COMMANDS)},
    **{action.arg: action.name for action in ACTIONS},
}
"""Names of the endpoints, by protobuf full name of the request; goals have no source."""


def command_name(command: AnsweredCommand) -> str:
    """Return the source of a command; without one, the endpoint that sends such commands."""
    request_type = type_of(command.message)
    return command.source or _NAMES.get(request_type, request_type)
