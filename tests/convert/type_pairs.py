"""The pairs of ROS and protobuf types between which the agent's endpoints convert."""

from __future__ import annotations

from typing import Any

from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, QUERIES, TOPICS
from woosh_robot_agent.link.protos import message_type


def field_class(part: Any, name: str = "") -> Any:
    """Return the message class of a field; by default of the only field."""
    types = part.get_fields_and_field_types()
    return class_of(types[name] if name else next(iter(types.values())), "msg")


def _pairs() -> dict[str, tuple[Any, Any]]:
    found = []
    for query in QUERIES:
        found.append((field_class(class_of(query.srv, "srv").Response), query.request))
    for command in COMMANDS:
        srv = class_of(command.srv, "srv")
        found.append((field_class(srv.Request, "arg"), command.request))
        if command.answer:
            found.append((field_class(srv.Response, "ret"), command.answer))
    for topic in TOPICS:
        found.append((class_of(topic.msg, "msg"), topic.push))
    for action in ACTIONS:
        cls = class_of(action.action, "action")
        found.append((field_class(cls.Goal), action.arg))
        found += [(field_class(part), action.feedback) for part in (cls.Feedback, cls.Result)]
    return {name: (cls, message_type(name)) for cls, name in found}


PAIRS = _pairs()
"""ROS class and protobuf class of each type of the endpoints, by protobuf full name."""
