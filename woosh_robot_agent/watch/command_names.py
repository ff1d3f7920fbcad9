"""Names of commands, as the table of endpoints has them."""

from __future__ import annotations

from woosh_robot_agent.endpoints import ACTIONS, COMMANDS
from woosh_robot_agent.motion import AnsweredCommand
from woosh_robot_agent.refusals import type_of

_NAMES = {
    # reversed, because two services may send the same request: the first in the table counts
    **{command.request: command.name for command in reversed(COMMANDS)},
    **{action.arg: action.name for action in ACTIONS},
}
"""Names of the endpoints that send commands, by protobuf full name of the request."""


def command_name(command: AnsweredCommand) -> str:
    """Return the source of a command; if it has none, the endpoint that sends such commands.

    The commands of goals have no source.
    """
    request_type = type_of(command.message)
    return command.source or _NAMES.get(request_type, request_type)
