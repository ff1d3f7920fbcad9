"""Write the messages of a vehicle, without their headers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.messages.factsheet import (
    ActionType,
    Factsheet,
    ParameterType,
)
from woosh_robot_agent.vda5050.messages.geometry import path_ahead
from woosh_robot_agent.vda5050.messages.order import (
    MAX_CONTROL_POINTS,
    MAX_INSTANT_ACTIONS,
    MAX_KNOTS,
    MAX_MESSAGE_SIZE,
    MAX_NODES,
    MAX_TEXT,
    Edge,
    Node,
    Trajectory,
)
from woosh_robot_agent.vda5050.messages.state import (
    ActionState,
    Battery,
    ConnectionState,
    ErrorLevel,
    ErrorType,
    OperatingMode,
    RobotStatus,
    VehicleError,
    VehicleState,
)
from woosh_robot_agent.vda5050.messages.versions import Version

Fields = dict[str, Any]
"""A message, or a part of one, as it is written in JSON."""
_MAX_SPEED = 1.0
"""Maximum speed in the factsheet, in m/s; the robot does not report its own."""
_MAX_ACCELERATION = 0.5
"""Maximum acceleration and deceleration in the factsheet, in m/s²; the robot reports neither."""
_MAX_ANGLE = 3.14159265359
"""Largest angle that the published schemas permit, in radians."""
OPTIONAL_PARAMETERS: Mapping[str, str] = {
    "order.nodes.nodePosition": "or nodeId is the number of a mark",
    "order.nodes.nodePosition.theta": "",
    "order.nodes.nodePosition.allowedDeviationXY": "",
    "order.nodes.nodePosition.allowedDeviationTheta": "",
    "order.edges.maxSpeed": "",
    "order.edges.orientation": "only TANGENTIAL 0: forwards",
    "order.edges.rotationAllowed": "only true",
    "order.edges.trajectory": "also several edges without a stop",
}
"""Optional fields of the standard that the connector obeys, with descriptions, if needed."""

_NOT_LOCALIZED = VehicleError(
    "LOCALIZATION_ERROR",
    ErrorLevel.FATAL,
    Sentence("the robot does not know its position")(),
    "place it on the map with initializePosition; if an order drives, cancel it first",
)


def state_message(version: Version, state: VehicleState) -> Fields:
    """Return a `state` message."""
    order, robot = state.order, state.robot
    message: Fields = {
        "orderId": order.order_id,
        "orderUpdateId": order.update_id,
        "lastNodeId": order.last_node_id,
        "lastNodeSequenceId": order.last_node_sequence_id,
        "nodeStates": list(map(_node_state, order.nodes)),
        "edgeStates": list(map(_edge_state, order.edges)),
        "driving": robot.driving,
        "paused": state.paused,
        "newBaseRequest": order.new_base_request,
        "batteryState": _battery(robot.battery),
        "operatingMode": version.value(robot.mode.value),
        "errors": [_error(version, each) for each in _errors(version, state)],
        "safetyState": {
            "eStop": "MANUAL" if robot.emergency_stop else "NONE",
            "fieldViolation": robot.field_violation,
        },
    }
    actions = [_action_state(version, each) for each in order.actions]
    instant_actions = [_action_state(version, each) for each in state.instant_actions]
    if version.is_3:
        message |= {"actionStates": actions, "instantActionStates": instant_actions}
        message |= _planned_path(state)
    else:
        message["actionStates"] = actions + instant_actions
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
    return _renamed(message | _motion(robot), version.names)


def visualization_message(version: Version, robot: RobotStatus, state_id: int) -> Fields:
    """Return a `visualization` message; `state_id` is the header id of the last `state` message."""
    reference = {"referenceStateHeaderId": state_id} if version.is_3 else {}
    return reference | _renamed(_motion(robot), version.names)


def connection_message(version: Version, state: ConnectionState) -> Fields:
    """Return a `connection` message."""
    return {"connectionState": version.value(state.value)}


def factsheet_message(version: Version, factsheet: Factsheet) -> Fields:
    """Return a `factsheet` message."""
    limits, kinematics = factsheet.limits, version.value(factsheet.kinematics)
    outline = [{"x": x, "y": y} for x, y in factsheet.outline]
    message: Fields = {
        "typeSpecification": _without_empty(
            {
                "seriesName": factsheet.series,
                "seriesDescription": factsheet.description,
                "agvKinematic": kinematics,
                "agvClass": factsheet.vehicle_class,
                "maxLoadMass": factsheet.max_load,
                "localizationTypes": ["NATURAL"],
                "navigationTypes": [version.value("AUTONOMOUS"), "VIRTUAL_LINE_GUIDED"],
            }
        ),
        "physicalParameters": {
            "speedMin": 0.0,
            "speedMax": _MAX_SPEED,
            "accelerationMax": _MAX_ACCELERATION,
            "decelerationMax": _MAX_ACCELERATION,
            "heightMin": factsheet.height,
            "heightMax": factsheet.height,
            "width": factsheet.width,
            "length": factsheet.length,
        },
        "protocolLimits": {
            "maxStringLens": {"msgLen": MAX_MESSAGE_SIZE, "idLen": MAX_TEXT},
            "maxArrayLens": {
                "order.nodes": MAX_NODES,
                "instantActions": MAX_INSTANT_ACTIONS,
                "trajectory.controlPoints": MAX_CONTROL_POINTS,
                "trajectory.knotVector": MAX_KNOTS,
            },
            "timing": {
                "minOrderInterval": 0.0,
                "minStateInterval": limits.min_state_interval,
                "defaultStateInterval": limits.state_interval,
                "visualizationInterval": limits.visualization_interval,
            },
        },
        "protocolFeatures": {
            "optionalParameters": [
                _without_empty(
                    {"parameter": name, "support": "SUPPORTED", "description": description}
                )
                for field, description in OPTIONAL_PARAMETERS.items()
                if (name := version.name(field))
            ],
            "agvActions": [_action_type(version, each) for each in factsheet.actions],
        },
        "agvGeometry": {
            "envelopes2d": [{"set": "outline", "polygonPoints": outline}] if outline else []
        },
        "loadSpecification": {},
        "vehicleConfig": {
            "versions": [{"key": key, "value": value} for key, value in factsheet.versions]
        },
    }
    if version.is_3:
        specification = message["typeSpecification"]
        specification["supportedZones"] = []  # the vehicle takes no zones
        # besides `mobileRobotKinematics`, the new name of `agvKinematic`, the schema requires:
        specification["mobileRobotKinematic"] = kinematics
    # `actionDescription` has another name in the other messages of version 3, but not here
    names = {old: new for old, new in version.names.items() if old != "actionDescription"}
    return _renamed(message, names)


def _renamed(message: Fields, names: Mapping[str, str]) -> Fields:
    """Return a message with its fields renamed, at any depth; `names` has old and new names."""

    def renamed(value: Any) -> Any:
        if isinstance(value, dict):
            return _renamed(value, names)
        return list(map(renamed, value)) if isinstance(value, list) else value

    return {names.get(key, key): renamed(value) for key, value in message.items()}


def _without_empty(message: Fields) -> Fields:
    """Return a message without its empty strings and lists."""
    return {key: value for key, value in message.items() if value not in ("", [])}


# Parts of the state


def _node_state(node: Node) -> Fields:
    state: Fields = {"nodeId": node.id, "sequenceId": node.sequence_id, "released": node.released}
    if node.description:
        state["nodeDescription"] = node.description
    if (place := node.position) is not None:
        state["nodePosition"] = {"x": place.x, "y": place.y, "mapId": place.map_id}
        if place.theta is not None:
            state["nodePosition"]["theta"] = place.theta
    return state


def _edge_state(edge: Edge) -> Fields:
    state: Fields = {"edgeId": edge.id, "sequenceId": edge.sequence_id, "released": edge.released}
    if edge.description:
        state["edgeDescription"] = edge.description
    if edge.trajectory is not None:
        state["trajectory"] = _trajectory(edge.trajectory)
    return state


def _trajectory(curve: Trajectory) -> Fields:
    points = [{"x": point.x, "y": point.y, "weight": point.weight} for point in curve.points]
    return {"degree": curve.degree, "knotVector": list(curve.knots), "controlPoints": points}


def _planned_path(state: VehicleState) -> Fields:
    """Return the field plannedPath; no field if the robot executes no order, or has no path.

    There is no `intermediatePath`, because the robot does not report arrival times.
    """
    place = state.robot.position
    if place is None or not state.order.nodes:
        return {}
    points = path_ahead(state.robot.path, place.point)
    if not points:
        return {}
    trajectory = {"degree": 1, "controlPoints": [{"x": x, "y": y} for x, y in points]}
    return {"plannedPath": {"trajectory": trajectory}}


def _action_state(version: Version, action: ActionState) -> Fields:
    optional = {
        "actionType": action.type,
        "actionDescription": action.description,
        "resultDescription": action.result,
    }
    status = version.value(action.status.value)
    return {"actionId": action.id, "actionStatus": status} | _without_empty(optional)


def _battery(battery: Battery) -> Fields:
    state: Fields = {"batteryCharge": battery.charge, "charging": battery.charging}
    if battery.health is not None:
        state["batteryHealth"] = round(battery.health)
    return state


def _motion(robot: RobotStatus) -> Fields:
    """Return the fields about the position and the velocity, as far as they are known."""
    message: Fields = {}
    if (place := robot.position) is not None:
        message["agvPosition"] = {
            "x": place.x,
            "y": place.y,
            # rounding may have led outside of the limits of the schemas
            "theta": max(-_MAX_ANGLE, min(_MAX_ANGLE, place.theta)),
            "mapId": place.map_id,
            "positionInitialized": place.initialised,
        }
    if robot.velocity is not None:
        message["velocity"] = {"vx": robot.velocity.vx, "vy": 0.0, "omega": robot.velocity.omega}
    return message


def _errors(version: Version, state: VehicleState) -> Iterable[VehicleError]:
    """Return the errors of the state.

    In version 3, LOCALIZATION_ERROR is added for an unknown position, and NOT_AVAILABLE ends with
    its cause.
    """
    if not version.is_3:
        return state.errors
    place = state.robot.position
    if place is None or not place.initialised:
        return (*state.errors, _NOT_LOCALIZED)
    if state.robot.mode is not OperatingMode.AUTOMATIC:
        return state.errors
    # the mode or position for which an order was rejected has changed, and so its error has ended
    return [each for each in state.errors if each.type != ErrorType.NOT_AVAILABLE]


_NAMES_IN_TEXTS = ("initPosition", "maxSpeed")
"""Names of fields and actions in the texts of errors that depend on the version."""


def _error(version: Version, error: VehicleError) -> Fields:
    """Return an error, with the names that the version gives its type, level and references."""
    kind = version.error_type(error.type)
    description, hint = error.description, error.hint
    for name in _NAMES_IN_TEXTS:
        description = description.replace(name, version.name(name))
        hint = hint.replace(name, version.name(name))
    references = [
        (key, (version.name(value) or value) if key == "parameter" else value)
        for key, value in error.references
    ]
    return _without_empty(
        {
            "errorType": kind,
            "errorLevel": version.error_levels.get(kind, version.value(error.level.value)),
            "errorDescription": description,
            "errorHint": hint,
            "errorReferences": [
                {"referenceKey": key, "referenceValue": value} for key, value in references
            ],
        }
    )


# Parts of the factsheet


def _action_type(version: Version, action: ActionType) -> Fields:
    """Return an action of the factsheet."""
    message = {
        "actionType": action.name,
        "actionDescription": action.description,
        "actionScopes": sorted(scope.value for scope in action.scopes),
        "actionParameters": [_parameter_type(version, each) for each in action.parameters],
        "resultDescription": action.result,
    }
    if version.is_3:  # in version 2.1 no list of blocking types fits the published schema
        message["blockingTypes"] = sorted(each.value for each in action.blocking)
        # the published schema demands texts, although the text of the standard says Boolean
        may_interrupt = str(action.moves).lower()
        message |= {"pauseAllowed": may_interrupt, "cancelAllowed": may_interrupt}
    return _without_empty(message)


def _parameter_type(version: Version, parameter: ParameterType) -> Fields:
    return {
        "key": parameter.key,
        "valueDataType": version.value(parameter.type),
        "description": parameter.description,
        "isOptional": parameter.optional,
    }
