"""Parts of messages that are the same in all versions, or differ only in names."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from woosh_robot_agent.vda5050.messages.factsheet import ParameterType, Scope
from woosh_robot_agent.vda5050.messages.order import (
    MAX_CONTROL_POINTS,
    MAX_INSTANT_ACTIONS,
    MAX_KNOTS,
    MAX_NODES,
    Action,
    BlockingType,
    ControlPoint,
    Edge,
    Node,
    NodePosition,
    Trajectory,
)
from woosh_robot_agent.vda5050.messages.state import (
    ActionState,
    OrderStatus,
    RobotStatus,
    VehicleError,
    Velocity,
)

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
    """Return a message without its empty strings and lists."""
    return {key: value for key, value in message.items() if value not in ("", [])}


def angle(value: float) -> float:
    """Clamp an angle to the limits of the schemas, which rounding may have exceeded."""
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
    degree = int(trajectory.get("degree", 1))  # JSON permits 3.0 for an integer
    return Trajectory(
        degree=degree,
        knots=tuple(trajectory.get("knotVector") or _uniform_knots(degree, len(points))),
        points=tuple(
            ControlPoint(point["x"], point["y"], point.get("weight", 1.0)) for point in points
        ),
    )


def _uniform_knots(degree: int, points: int) -> list[float]:
    """Return uniform knots of a curve that begins and ends at its outer control points."""
    spans = max(1, points - degree)
    inner = [number / spans for number in range(1, spans)]
    return [0.0] * (degree + 1) + inner + [1.0] * (degree + 1)


def unsupported(
    message: Mapping[str, Any],
    names: Iterable[str],
    always_obeyed: Mapping[str, Callable[[Mapping[str, Any]], bool]],
) -> tuple[str, ...]:
    """Return the names of the fields of a message that the robot cannot obey.

    Args:
        message: an edge.
        names: fields that the robot cannot obey.
        always_obeyed: functions that return True if the value of a field asks for what the robot
            does anyway, by name of the field.
    """
    return tuple(
        name
        for name in names
        if name in message and not (name in always_obeyed and always_obeyed[name](message))
    )


def is_tangential(edge: Mapping[str, Any]) -> bool:
    """Return True if the orientation of an edge is that of a robot that drives forwards."""
    return not edge["orientation"] and edge.get("orientationType", "TANGENTIAL") == "TANGENTIAL"


# From the vehicle


def node_state(node: Node, description: str) -> dict[str, Any]:
    """Return an item of nodeStates.

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
    """Return an item of edgeStates.

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
    """Return the field `trajectory`."""
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
    """Return an item of actionStates.

    Args:
        action: the action.
        status: name of its status.
        description: name of the field with its description.
        result: name of the field with its result.
    """
    optional = {"actionType": action.type, description: action.description, result: action.result}
    return {"actionId": action.id, "actionStatus": status} | without_empty(optional)


def error(value: VehicleError, kind: str, level: str) -> dict[str, Any]:
    """Return an item of `errors`.

    Args:
        value: the error.
        kind: errorType.
        level: errorLevel.
    """
    return without_empty(
        {
            "errorType": kind,
            "errorLevel": level,
            "errorDescription": value.description,
            "errorHint": value.hint,
            "errorReferences": [
                {"referenceKey": reference.key, "referenceValue": reference.value}
                for reference in value.references
            ],
        }
    )


def velocity(value: Velocity) -> dict[str, Any]:
    """Return the field `velocity`."""
    return {"vx": value.vx, "vy": 0.0, "omega": value.omega}


def known_state(order: OrderStatus, robot: RobotStatus) -> dict[str, Any]:
    """Return the optional fields of a state of which the values are known."""
    message: dict[str, Any] = {}
    if order.distance_since_last_node is not None:
        message["distanceSinceLastNode"] = round(order.distance_since_last_node, 3)
    if robot.loaded is not None:
        message["loads"] = [{}] if robot.loaded else []  # nothing else is known about a load
    if robot.maps is not None:
        message["maps"] = [
            {
                "mapId": each.id,
                "mapVersion": each.version,
                "mapStatus": "ENABLED" if each.enabled else "DISABLED",
            }
            for each in robot.maps
        ]
    return message


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
