"""The .action files of actions."""

from __future__ import annotations

from woosh_robot_agent.endpoints import Action
from woosh_robot_agent.interfaces.definition import Line, parts_text
from woosh_robot_agent.interfaces.names import message_name
from woosh_robot_agent.interfaces.schema import Schema
from woosh_robot_agent.interfaces.services import ARG


def action_file(action: Action, schema: Schema) -> str:
    """Return the .action file of an action."""
    message = schema.message(action.arg)
    report = message_name(schema.message(action.feedback))
    return parts_text(
        f"{schema.comment(message)}\nStarts {action.arg} and follows its reports.",
        [Line(f"{message_name(message)} arg", ARG)],
        [Line(f"{report} ret", "The last report of the chassis, which ended the goal")],
        [Line(f"{report} fb", "Progress report of the chassis")],
    )
