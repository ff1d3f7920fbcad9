"""Parts of messages that are the same in all versions, or differ in a name only."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from woosh_robot_agent.vda5050.model.errors import VehicleError
from woosh_robot_agent.vda5050.model.factsheet import ParameterType, Scope
from woosh_robot_agent.vda5050.model.limits import (
    MAX_CONTROL_POINTS,
    MAX_INSTANT_ACTIONS,
    MAX_KNOTS,
    MAX_NODES,
)
from woosh_robot_agent.vda5050.model.order import (
    Action,
    BlockingType,
    ControlPoint,
    Edge,
    Node,
    NodePosition,
    Trajectory,
)
from woosh_robot_agent.vda5050.model.state import ActionState, Load, Map, Velocity

_MAX_ANGLE = 3.14159265359
"""Largest angle that the published schemas permit, in radians."""

ARRAY_LIMITS: Mapping[str, int] = {
    "order.nodes": MAX_NODES,
    "instantActions": MAX_INSTANT_ACTIONS,
    "trajectory.controlPoints": MAX_CONTROL_POINTS,
    "trajectory.knotVector": MAX_KNOTS,
}
"""Maximum lengths of arrays, for the factsheet."""


def without_empty(message: dict[str, Any]) -> dict[str, Any]:
    """Return a message without its empty texts and lists."""
    return {key: value for key, value in message.items() if value not in ("", [])}


def angle(value: float) -> float:
    """Return an angle within the limits of the schemas; rounding may have moved it outside."""
    return max(-_MAX_ANGLE, min(_MAX_ANGLE, value))


# From the master control


def read_action(action: Mapping[str, Any], description: str) -> Action:
    """Return a received action.

    Args:
        action: the action.
        description: name of the field with its description.
    """
    return Action(
        id=action["actionId"],
        type=action["actionType"],
        blocking=BlockingType(action["blockingType"]),
        parameters={each["key"]: each["value"] for each in action.get("actionParameters", ())},
        description=action.get(description, ""),
    )


def read_trajectory(trajectory: Mapping[str, Any]) -> Trajectory:
    """Return a received trajectory."""
    points = trajectory["controlPoints"]
    degree = trajectory.get("degree", 1)
    return Trajectory(
        degree=degree,
        knots=tuple(trajectory.get("knotVector") or _uniform_knots(degree, len(points))),
        points=tuple(
            ControlPoint(point["x"], point["y"], point.get("weight", 1.0)) for point in points
        ),
    )


def _uniform_knots(degree: int, points: int) -> list[float]:
    """Return the knots of a curve that begins and ends at its control points."""
    spans = max(1, points - degree)
    inner = [number / spans for number in range(1, spans)]
    return [0.0] * (degree + 1) + inner + [1.0] * (degree + 1)


# From the vehicle


def node_state(node: Node, description: str) -> dict[str, Any]:
    """Return the state of a node.

    Args:
        node: the node.
        description: name of the field with its description.
    """
    state: dict[str, Any] = {
        "nodeId": node.id,
        "sequenceId": node.sequence_id,
        "released": node.released,
    }
    if node.description:
        state[description] = node.description
    if node.position is not None:
        state["nodePosition"] = _node_position(node.position)
    return state


def _node_position(place: NodePosition) -> dict[str, Any]:
    message: dict[str, Any] = {"x": place.x, "y": place.y, "mapId": place.map_id}
    if place.theta is not None:
        message["theta"] = place.theta
    return message


def edge_state(edge: Edge, description: str) -> dict[str, Any]:
    """Return the state of an edge.

    Args:
        edge: the edge.
        description: name of the field with its description.
    """
    state: dict[str, Any] = {
        "edgeId": edge.id,
        "sequenceId": edge.sequence_id,
        "released": edge.released,
    }
    if edge.description:
        state[description] = edge.description
    if edge.trajectory is not None:
        state["trajectory"] = trajectory(edge.trajectory)
    return state


def trajectory(curve: Trajectory) -> dict[str, Any]:
    """Return the message of a trajectory."""
    return {
        "degree": curve.degree,
        "knotVector": list(curve.knots),
        "controlPoints": [
            {"x": point.x, "y": point.y, "weight": point.weight} for point in curve.points
        ],
    }


def action_state(
    action: ActionState, status: str, *, description: str, result: str
) -> dict[str, Any]:
    """Return the state of an action.

    Args:
        action: the action.
        status: name of its status.
        description: name of the field with its description.
        result: name of the field with its result.
    """
    optional = {"actionType": action.type, description: action.description, result: action.result}
    return {"actionId": action.id, "actionStatus": status} | without_empty(optional)


def error(each: VehicleError, kind: str, level: str) -> dict[str, Any]:
    """Return the message of an error.

    Args:
        each: the error.
        kind: name of its type.
        level: name of its level.
    """
    return without_empty(
        {
            "errorType": kind,
            "errorLevel": level,
            "errorDescription": each.description,
            "errorHint": each.hint,
            "errorReferences": [
                {"referenceKey": reference.key, "referenceValue": reference.value}
                for reference in each.references
            ],
        }
    )


def velocity(value: Velocity) -> dict[str, Any]:
    """Return the message of a velocity."""
    return {"vx": value.vx, "vy": 0.0, "omega": value.omega}


def load(each: Load) -> dict[str, Any]:
    """Return the message of a load."""
    message = without_empty({"loadType": each.type})
    if each.id is not None:
        message["loadId"] = each.id
    return message


def map_state(each: Map) -> dict[str, Any]:
    """Return the message of a map."""
    return {
        "mapId": each.id,
        "mapVersion": each.version,
        "mapStatus": "ENABLED" if each.enabled else "DISABLED",
    }


def parameter_types(
    parameters: Iterable[ParameterType], type_name: Callable[[str], str] = str
) -> list[dict[str, Any]]:
    """Return the parameters of an action for the factsheet.

    Args:
        parameters: the parameters.
        type_name: returns the version's name of a data type.
    """
    return [
        {
            "key": each.key,
            "valueDataType": type_name(each.type),
            "description": each.description,
            "isOptional": each.optional,
        }
        for each in parameters
    ]


def scopes(values: Iterable[Scope]) -> list[str]:
    """Return the names of scopes."""
    return sorted(scope.value for scope in values)
