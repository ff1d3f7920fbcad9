"""The .srv files of queries and commands."""

from __future__ import annotations

from woosh_robot_agent.endpoints import Command, Query
from woosh_robot_agent.interfaces.definition import Line, parts_text
from woosh_robot_agent.interfaces.names import message_name
from woosh_robot_agent.interfaces.schema import Schema

ARG = "The request to the chassis"
"""Comment of the field `arg` of requests and goals."""


def query_file(query: Query, schema: Schema) -> str:
    """Return the .srv file of a query."""
    message = schema.message(query.request)
    name = message_name(message)
    value = "Current value of the chassis, or the last known one if the chassis does not answer"
    return parts_text(
        f"{schema.comment(message)}\nAsks the chassis for {query.request}.",
        [Line(f"{name} arg", ARG)] if query.takes_arg else [],
        [Line(f"{name} {query.field}", value)],
    )


def command_file(command: Command, schema: Schema) -> str:
    """Return the .srv file of a command."""
    message = schema.message(command.request)
    response = [
        Line("bool ok", "True when the chassis accepted the request"),
        Line(
            "string msg",
            "Text of the chassis's answer; without an answer, the cause and the remedy",
        ),
    ]
    if command.answer:
        answer = message_name(schema.message(command.answer))
        text = "Answer of the chassis; default values if there was none"
        response.insert(0, Line(f"{answer} ret", text))
    return parts_text(
        f"{schema.comment(message)}\nSends {command.request}.",
        [Line(f"{message_name(message)} arg", ARG)],
        response,
    )
