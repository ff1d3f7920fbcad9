"""Check the messages of the master control by the published JSON schemas, and read them."""

from __future__ import annotations

import functools
import itertools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match
from jsonschema.protocols import Validator

from woosh_robot_agent.sentences import Sentence, said_by
from woosh_robot_agent.vda5050.messages.order import (
    MAX_DEGREE,
    MAX_INSTANT_ACTIONS,
    MAX_MESSAGE_SIZE,
    MAX_TEXT,
    Action,
    BlockingType,
    ControlPoint,
    Edge,
    Ellipse,
    Node,
    NodePosition,
    Order,
    Trajectory,
)
from woosh_robot_agent.vda5050.messages.state import (
    ErrorType,
    RejectedError,
    VehicleError,
    warning,
)
from woosh_robot_agent.vda5050.messages.versions import OBEYED_ANYWAY, Identity, Topic, Version

SCHEMAS = Path(__file__).with_name("schemas")
"""Folder of the schemas, with a folder for each version of the standard."""
_MAX_ERRORS = 100
"""Maximum number of schema errors from which the most relevant one is chosen."""
_MAX_VALUE = 200
"""Maximum length of a value of a message that is repeated in an error, in characters."""


@functools.cache
def _validator(version: str, topic: str) -> Validator:
    """Return the validator of a message.

    Args:
        version: version of the standard, e.g. `2.1.0`.
        topic: last level of the topic, e.g. `order`.
    """
    text = (SCHEMAS / version / f"{topic}.schema").read_text("utf-8")
    return Draft202012Validator(
        json.loads(text), format_checker=Draft202012Validator.FORMAT_CHECKER
    )


def defect(version: str, topic: str, message: Any) -> tuple[str, str] | None:
    """Return the path of an invalid field of a message and the reason; None for a valid message.

    The path is empty if the message as a whole is invalid, e.g. because a field is missing.
    """
    errors = itertools.islice(_validator(version, topic).iter_errors(message), _MAX_ERRORS)
    error = best_match(errors)
    if error is None:
        return None
    path = ".".join(str(part) for part in error.absolute_path)
    reason = error.message
    return path, reason if len(reason) <= _MAX_VALUE else reason[: _MAX_VALUE - 3] + "..."


_MESSAGE = Sentence("the message on {topic} {reason}")
_MANY_ACTIONS = Sentence("has {count} actions, more than {most}")
_NO_ZONES = Sentence("the robot takes no zones")
_MANY_BYTES = Sentence("it has {count} bytes, more than {most}")
_ENCODING = Sentence("it is encoded in {encoding}; send UTF-8")
_UNREADABLE = Sentence("cannot be read: {error}")
_MALFORMED = Sentence("is malformed at {place}: {reason}")
_TOP_LEVEL = Sentence("its top level")
_VERSION = Sentence("has version {version}; the vehicle speaks {own}")
_OTHER_VEHICLE = Sentence("is for {key} {value}; this vehicle has {own}")
_LONG_TEXT = Sentence("a text has {count} characters, more than {most}")
_LARGE_NUMBER = Sentence("a number is not between -{most} and {most}")
_DEEP = Sentence("it is nested more than {most} levels deep")
_MAX_DEPTH = 50
"""Maximum depth of nested lists and objects in a message."""
_MAX_NUMBER = 2.0**53
"""Maximum of the absolute value of a number in a message."""
_MAX_REASON = 500
"""Maximum length of the description of an error, in characters."""


def read_order(payload: bytes, version: Version, identity: Identity) -> Order:
    """Return a received order.

    Raises:
        RejectedError: the message is malformed, or not for this vehicle.
    """
    message = _parse(payload, version, identity, Topic.ORDER)
    nodes = {node["sequenceId"]: node["nodeId"] for node in message["nodes"]}
    return Order(
        id=message["orderId"],
        update_id=int(message["orderUpdateId"]),
        nodes=tuple(_node(version, node) for node in message["nodes"]),
        edges=tuple(_edge(version, edge, nodes) for edge in message["edges"]),
        unsupported=_unsupported(version, message),
    )


def read_instant_actions(payload: bytes, version: Version, identity: Identity) -> list[Action]:
    """Return received instant actions.

    Raises:
        RejectedError: the message is malformed, or not for this vehicle.
    """
    topic = Topic.INSTANT_ACTIONS
    message = _parse(payload, version, identity, topic)
    if (count := len(message["actions"])) > MAX_INSTANT_ACTIONS:
        raise _rejection(topic, message, _MANY_ACTIONS(count=count, most=MAX_INSTANT_ACTIONS))
    return [_action(version, action) for action in message["actions"]]


def refusal_of_zone_set(payload: bytes, version: Version, identity: Identity) -> VehicleError:
    """Return the error for a received zone set: it is malformed, or the robot takes no zones."""
    try:
        message = _parse(payload, version, identity, Topic.ZONE_SET)
    except RejectedError as rejected:
        return rejected.error
    return warning(
        ErrorType.UNSUPPORTED_PARAMETER,
        _NO_ZONES(),
        "send no zone sets: supportedZones of the factsheet is empty",
        topic=Topic.ZONE_SET.value,
        zoneSetId=message["zoneSet"]["zoneSetId"],
    )


def _unsupported(version: Version, order: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of set fields of an order, or of its actions, that the robot cannot obey."""
    if not version.is_3:
        return ("zoneSetId",) if order.get("zoneSetId") else ()
    parts = (*order["nodes"], *order["edges"])
    retriable = any(action.get("retriable") for part in parts for action in part["actions"])
    return ("retriable",) if retriable else ()


def _node(version: Version, node: Mapping[str, Any]) -> Node:
    position = node.get("nodePosition")
    return Node(
        id=node["nodeId"],
        sequence_id=int(node["sequenceId"]),
        released=node["released"],
        position=None if position is None else _position(position),
        actions=tuple(_action(version, action) for action in node["actions"]),
        description=node.get(version.name("nodeDescription"), ""),
    )


def _position(position: Mapping[str, Any]) -> NodePosition:
    """Return a received position of a node; only in version 3, the deviation may be an ellipse."""
    radius, ellipse = position.get("allowedDeviationXY", 0.0), None
    if isinstance(radius, dict):  # in version 3
        if radius["a"] != radius["b"]:
            ellipse = Ellipse(radius["a"], radius["b"], radius["theta"])
        radius = min(radius["a"], radius["b"])
    return NodePosition(
        x=position["x"],
        y=position["y"],
        map_id=position["mapId"],
        theta=position.get("theta"),
        deviation_xy=radius,
        deviation_theta=position.get("allowedDeviationTheta", 0.0),
        ellipse=ellipse,
    )


def _edge(version: Version, edge: Mapping[str, Any], nodes: Mapping[int, str]) -> Edge:
    """Return a received edge of an order with these nodes (ids by sequence ids)."""
    trajectory = edge.get("trajectory")
    number = int(edge["sequenceId"])
    if version.is_3:  # an edge does not name its nodes
        ends = nodes.get(number - 1, ""), nodes.get(number + 1, "")
    else:
        ends = edge["startNodeId"], edge["endNodeId"]
    return Edge(
        id=edge["edgeId"],
        sequence_id=number,
        start_node_id=ends[0],
        end_node_id=ends[1],
        released=edge["released"],
        max_speed=edge.get(version.name("maxSpeed")),
        trajectory=None if trajectory is None else _trajectory(trajectory),
        actions=tuple(_action(version, action) for action in edge["actions"]),
        description=edge.get(version.name("edgeDescription"), ""),
        unsupported=tuple(
            name
            for name in version.unsupported_edge_fields
            if name in edge and not (name in OBEYED_ANYWAY and OBEYED_ANYWAY[name](edge))
        ),
    )


def _action(version: Version, action: Mapping[str, Any]) -> Action:
    return Action(
        id=action["actionId"],
        type=action["actionType"],
        blocking=BlockingType(action["blockingType"]),
        parameters={each["key"]: each["value"] for each in action.get("actionParameters", ())},
        description=action.get(version.name("actionDescription"), ""),
    )


def _trajectory(trajectory: Mapping[str, Any]) -> Trajectory:
    points = trajectory["controlPoints"]
    degree = int(trajectory.get("degree", 1))  # JSON permits 3.0 for an integer
    # a higher degree is refused later, but its knots might not fit into the memory
    uniform = _uniform_knots(min(degree, MAX_DEGREE), len(points))
    return Trajectory(
        degree=degree,
        knots=tuple(trajectory.get("knotVector") or uniform),
        points=tuple(
            ControlPoint(point["x"], point["y"], point.get("weight", 1.0)) for point in points
        ),
    )


def _uniform_knots(degree: int, points: int) -> list[float]:
    """Return uniform knots of a curve that begins and ends at its outer control points."""
    spans = max(1, points - degree)
    inner = [number / spans for number in range(1, spans)]
    return [0.0] * (degree + 1) + inner + [1.0] * (degree + 1)


def _parse(payload: bytes, version: Version, identity: Identity, topic: Topic) -> dict[str, Any]:
    """Parse and check a message of the master control, and return it.

    Raises:
        RejectedError: the message is malformed, or not for this vehicle.
    """
    message: Any = None
    try:
        if len(payload) > MAX_MESSAGE_SIZE:
            raise ValueError(_MANY_BYTES(count=len(payload), most=MAX_MESSAGE_SIZE))
        if not (encoding := json.detect_encoding(payload)).startswith("utf-8"):
            raise ValueError(_ENCODING(encoding=encoding))
        message = json.loads(payload)
        _check_limits(message)
    except (ValueError, RecursionError) as error:
        raise _rejection(topic, None, _UNREADABLE(error=said_by(error))) from None
    if found := defect(version.number, topic.value, message):
        field_path, detail = found
        reason = _MALFORMED(place=field_path or _TOP_LEVEL(), reason=detail)
        raise _rejection(topic, message, reason)
    if message["version"].split(".")[0] != version.number.split(".")[0]:
        reason = _VERSION(version=message["version"], own=version.number)
        raise _rejection(topic, message, reason)
    for key, own in (
        ("manufacturer", identity.manufacturer),
        ("serialNumber", identity.serial_number),
    ):
        if message[key] != own:
            reason = _OTHER_VEHICLE(key=key, value=message[key], own=own)
            raise _rejection(topic, message, reason)
    return message  # type: ignore[no-any-return]


def _check_limits(message: Any) -> None:
    """Check that no text, number or nesting of a message exceeds the limits.

    Raises:
        ValueError: a text, a number or the nesting exceeds its limit.
    """
    level = [message]
    for _ in range(_MAX_DEPTH):
        following: list[Any] = []
        for value in level:
            if isinstance(value, str):
                value.encode()  # raises for lone surrogates, which JSON can hold
                if len(value) > MAX_TEXT:
                    raise ValueError(_LONG_TEXT(count=len(value), most=MAX_TEXT))
            if isinstance(value, float | int) and not abs(value) <= _MAX_NUMBER:
                raise ValueError(_LARGE_NUMBER(most=f"{_MAX_NUMBER:g}"))
            if isinstance(value, dict):
                following += [*value.keys(), *value.values()]
            elif isinstance(value, list):
                following += value
        if not following:
            return
        level = following
    raise ValueError(_DEEP(most=_MAX_DEPTH))


def _rejection(topic: Topic, message: Any, reason: str) -> RejectedError:
    """Return the exception that rejects a message; the message is None if it is not readable."""
    references = {
        key: str(message[key])[:_MAX_VALUE]
        for key in ("headerId", "orderId", "orderUpdateId")
        if isinstance(message, dict) and key in message
    }
    text = _MESSAGE(topic=topic.value, reason=reason)
    return RejectedError(
        warning(
            ErrorType.VALIDATION,
            # cut only if necessary: the dashboard cannot translate a slice, a plain string
            text if len(text) <= _MAX_REASON else text[:_MAX_REASON],
            "correct the message and send it again",
            topic=topic.value,
            **references,
        )
    )
