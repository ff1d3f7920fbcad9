"""Version 3.0.0 of the standard."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

from woosh_robot_agent.vda5050.messages import parts
from woosh_robot_agent.vda5050.messages.factsheet import (
    ActionType,
    Factsheet,
    Kinematics,
    OptionalParameter,
)
from woosh_robot_agent.vda5050.messages.order import (
    MAX_MESSAGE_SIZE,
    MAX_TEXT,
    Action,
    Edge,
    Ellipse,
    Node,
    NodePosition,
    Order,
    path_ahead,
)
from woosh_robot_agent.vda5050.messages.protocol import Topic
from woosh_robot_agent.vda5050.messages.state import (
    ActionState,
    Battery,
    ConnectionState,
    ErrorLevel,
    ErrorType,
    OperatingMode,
    Reference,
    RobotStatus,
    VehicleError,
    VehicleState,
)

_UNSUPPORTED_EDGE_FIELDS = (
    "corridor",
    "direction",
    "maximumMobileRobotHeight",
    "maximumRotationSpeed",
    "maxRotationSpeed",  # its name in the published schema
    "minimumLoadHandlingDeviceHeight",
    "orientation",
    "reachOrientationBeforeEntering",
)
"""Fields of an edge that the robot cannot obey."""
_ALWAYS_OBEYED: Mapping[str, Callable[[Mapping[str, Any]], bool]] = {
    "orientation": parts.is_tangential,
    "reachOrientationBeforeEntering": lambda edge: not edge["reachOrientationBeforeEntering"],
}
"""Functions that return True if such a field asks for what the robot does anyway: it drives
forwards."""
_PARAMETERS: Mapping[str, str] = {
    "order.edges.maxSpeed": "order.edges.maximumSpeed",
    "order.edges.rotationAllowed": "",
    "maxSpeed": "maximumSpeed",
}
"""Names of optional fields that differ from those of version 2.1; empty for a field that this
version does not have."""
_ERROR_TYPES: Mapping[str, str] = {
    ErrorType.VALIDATION: "VALIDATION_FAILURE",
    ErrorType.ORDER: "INVALID_ORDER",
    ErrorType.ORDER_ACTION: "INVALID_ORDER_ACTION",
    ErrorType.NOT_AVAILABLE: "MOBILE_ROBOT_NOT_AVAILABLE",
    ErrorType.UNKNOWN_MAP: "UNKNOWN_MAP_ID",
    ErrorType.NO_ROUTE: "START_NODE_OUT_OF_RANGE",
    ErrorType.ORDER_UPDATE: "INVALID_ORDER",
    ErrorType.OUTDATED_UPDATE: "OUTDATED_ORDER_UPDATE",
    ErrorType.CHANGED_UPDATE: "SAME_ORDER_UPDATE_ID",
    ErrorType.UPDATE_AFTER_CANCEL: "ORDER_UPDATE_FOLLOWING_CANCEL",
    ErrorType.DRIVING: "NODE_UNREACHABLE",
    ErrorType.INSTANT_ACTION: "INVALID_INSTANT_ACTION",
}
"""errorType of errors; of others it is `ErrorType.value` in capitals with underscores."""
_ERROR_LEVELS = {"UNSUPPORTED_PARAMETER": "CRITICAL", "NODE_UNREACHABLE": "CRITICAL"}
"""Levels that the standard prescribes and that differ from `VehicleError.level`."""
_NOT_LOCALIZED = VehicleError(
    "LOCALIZATION_ERROR",
    ErrorLevel.FATAL,
    "the robot does not know its position",
    "initialise it with initializePosition",
)
_MODES = {OperatingMode.TEACH_IN: "TEACH_IN"}
"""Names of operating modes; the others are `OperatingMode.value`."""
_CONNECTION_STATES = {ConnectionState.BROKEN: "CONNECTION_BROKEN"}
"""Names of connection states; the others are `ConnectionState.value`."""
_KINEMATICS = {
    Kinematics.DIFFERENTIAL: "DIFFERENTIAL",
    Kinematics.OMNIDIRECTIONAL: "OMNIDIRECTIONAL",
}
_DATA_TYPES = {"FLOAT": "NUMBER"}
"""Substitutes for data types of parameters that this version lacks."""
_TRUE = "true"
"""The published schema demands a string, although the text of the standard says Boolean."""
_FALSE = "false"


class Version30:
    """Messages of version 3.0.0."""

    number: ClassVar[str] = "3.0.0"
    received: ClassVar[frozenset[Topic]] = frozenset(
        {Topic.ORDER, Topic.INSTANT_ACTIONS, Topic.ZONE_SET}
    )
    keeps_instant_actions: ClassVar[bool] = True
    clears_lost_orders: ClassVar[bool] = True

    # From the fleet control

    def order(self, message: Mapping[str, Any]) -> Order:
        nodes = {node["sequenceId"]: node["nodeId"] for node in message["nodes"]}
        return Order(
            id=message["orderId"],
            update_id=int(message["orderUpdateId"]),
            nodes=tuple(map(_read_node, message["nodes"])),
            edges=tuple(_read_edge(edge, nodes) for edge in message["edges"]),
            unsupported=_unsupported_action_fields([*message["nodes"], *message["edges"]]),
        )

    def instant_actions(self, message: Mapping[str, Any]) -> list[Action]:
        return [_read_action(action) for action in message["actions"]]

    # From the vehicle

    def state(self, state: VehicleState) -> dict[str, Any]:
        order, robot = state.order, state.robot
        message: dict[str, Any] = {
            "orderId": order.order_id,
            "orderUpdateId": order.update_id,
            "lastNodeId": order.last_node_id,
            "lastNodeSequenceId": order.last_node_sequence_id,
            "nodeStates": [parts.node_state(each, "nodeDescriptor") for each in order.nodes],
            "edgeStates": [parts.edge_state(each, "edgeDescriptor") for each in order.edges],
            "driving": robot.driving,
            "paused": order.paused,
            "newBaseRequest": order.new_base_request,
            "actionStates": [_action_state(each) for each in order.actions if not each.instant],
            "instantActionStates": [_action_state(each) for each in order.actions if each.instant],
            "powerSupply": _power_supply(robot.battery),
            "operatingMode": _MODES.get(robot.mode, robot.mode.value),
            "errors": [_error(each) for each in _current_errors(state)],
            "safetyState": {
                "activeEmergencyStop": robot.emergency_stop.value,
                "fieldViolation": robot.field_violation,
            },
        }
        return message | parts.known_state(order, robot) | _motion(robot) | _planned_path(state)

    def visualization(self, robot: RobotStatus, state_id: int) -> dict[str, Any]:
        return {"referenceStateHeaderId": state_id} | _motion(robot)

    def connection(self, state: ConnectionState) -> dict[str, Any]:
        return {"connectionState": _CONNECTION_STATES.get(state, state.value)}

    def factsheet(self, factsheet: Factsheet) -> dict[str, Any]:
        kinematics = _KINEMATICS[factsheet.kinematics]
        return {
            "typeSpecification": parts.without_empty(
                {
                    "seriesName": factsheet.series,
                    "seriesDescription": factsheet.description,
                    "mobileRobotKinematics": kinematics,
                    # the published schema requires this spelling
                    "mobileRobotKinematic": kinematics,
                    "mobileRobotClass": factsheet.vehicle_class.value,
                    "maximumLoadMass": factsheet.max_load,
                    "localizationTypes": ["NATURAL"],
                    "navigationTypes": ["FREELY_NAVIGATING", "VIRTUAL_LINE_GUIDED"],
                }
            )
            | {"supportedZones": []},
            "physicalParameters": {
                "minimumSpeed": 0.0,
                "maximumSpeed": factsheet.max_speed,
                "maximumAcceleration": factsheet.max_acceleration,
                "maximumDeceleration": factsheet.max_acceleration,
                "minimumHeight": factsheet.height,
                "maximumHeight": factsheet.height,
                "width": factsheet.width,
                "length": factsheet.length,
            },
            "protocolLimits": {
                "maximumStringLengths": {
                    "maximumMessageLength": MAX_MESSAGE_SIZE,
                    "maximumIdLength": MAX_TEXT,
                },
                "maximumArrayLengths": dict(parts.ARRAY_LIMITS),
                "timing": {
                    "minimumOrderInterval": 0.0,
                    "minimumStateInterval": factsheet.min_state_interval,
                    "defaultStateInterval": factsheet.state_interval,
                    "visualizationInterval": factsheet.visualization_interval,
                },
            },
            "protocolFeatures": {
                "optionalParameters": [
                    _optional_parameter(each)
                    for each in factsheet.optional_parameters
                    if _PARAMETERS.get(each.name, each.name)
                ],
                "mobileRobotActions": [_action_type(action) for action in factsheet.actions],
            },
            "mobileRobotGeometry": {
                "envelopes2d": [
                    {
                        "envelope2dId": "outline",
                        "vertices": [{"x": x, "y": y} for x, y in factsheet.outline],
                    }
                ]
                if factsheet.outline
                else []
            },
            "loadSpecification": {},
            "mobileRobotConfiguration": {
                "versions": [{"key": key, "value": value} for key, value in factsheet.versions]
            },
        }


# From the fleet control


def _read_node(node: Mapping[str, Any]) -> Node:
    position = node.get("nodePosition")
    return Node(
        id=node["nodeId"],
        sequence_id=int(node["sequenceId"]),
        released=node["released"],
        position=None if position is None else _read_position(position),
        actions=tuple(map(_read_action, node["actions"])),
        description=node.get("nodeDescriptor", ""),
    )


def _read_position(position: Mapping[str, Any]) -> NodePosition:
    deviation = position.get("allowedDeviationXY", {"a": 0.0, "b": 0.0, "theta": 0.0})
    ellipse = Ellipse(deviation["a"], deviation["b"], deviation["theta"])
    return NodePosition(
        x=position["x"],
        y=position["y"],
        map_id=position["mapId"],
        theta=position.get("theta"),
        deviation_xy=min(ellipse.a, ellipse.b),
        deviation_theta=position.get("allowedDeviationTheta", 0.0),
        ellipse=None if ellipse.a == ellipse.b else ellipse,
    )


def _read_edge(edge: Mapping[str, Any], nodes: Mapping[int, str]) -> Edge:
    """Return a received edge.

    Args:
        edge: the edge.
        nodes: ids of the nodes of the order, by their sequence ids.
    """
    trajectory = edge.get("trajectory")
    number = int(edge["sequenceId"])
    return Edge(
        id=edge["edgeId"],
        sequence_id=number,
        start_node_id=nodes.get(number - 1, ""),
        end_node_id=nodes.get(number + 1, ""),
        released=edge["released"],
        max_speed=edge.get("maximumSpeed"),
        trajectory=None if trajectory is None else parts.read_trajectory(trajectory),
        actions=tuple(map(_read_action, edge["actions"])),
        description=edge.get("edgeDescriptor", ""),
        unsupported=parts.unsupported(edge, _UNSUPPORTED_EDGE_FIELDS, _ALWAYS_OBEYED),
    )


def _read_action(action: Mapping[str, Any]) -> Action:
    return parts.read_action(action, "actionDescriptor")


def _unsupported_action_fields(places: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return the names of fields of actions that the robot cannot obey."""
    retriable = any(action.get("retriable") for place in places for action in place["actions"])
    return ("retriable",) if retriable else ()


# From the vehicle


def _action_state(action: ActionState) -> dict[str, Any]:
    return parts.action_state(
        action, action.status.value, description="actionDescriptor", result="actionResult"
    )


def _motion(robot: RobotStatus) -> dict[str, Any]:
    message: dict[str, Any] = {}
    if robot.position is not None:
        place = robot.position
        message["mobileRobotPosition"] = {
            "x": place.x,
            "y": place.y,
            "theta": parts.angle(place.theta),
            "mapId": place.map_id,
            "localized": place.initialised,
        }
    if robot.velocity is not None:
        message["velocity"] = parts.velocity(robot.velocity)
    return message


def _planned_path(state: VehicleState) -> dict[str, Any]:
    """Return the field plannedPath while the robot executes an order; empty without a path.

    There is no `intermediatePath`, because the robot does not report arrival times.
    """
    place = state.robot.position
    if place is None or not state.order.nodes:
        return {}
    points = path_ahead(state.robot.path, (place.x, place.y))
    if not points:
        return {}
    trajectory = {"degree": 1, "controlPoints": [{"x": x, "y": y} for x, y in points]}
    return {"plannedPath": {"trajectory": trajectory}}


def _power_supply(battery: Battery) -> dict[str, Any]:
    message: dict[str, Any] = {"stateOfCharge": battery.charge, "charging": battery.charging}
    if battery.health is not None:
        message["batteryHealth"] = round(battery.health)
    return message


def _current_errors(state: VehicleState) -> list[VehicleError]:
    """Return the errors that this version reports now."""
    place = state.robot.position
    is_lost = place is not None and not place.initialised
    errors = list(state.errors)
    if state.robot.mode is OperatingMode.AUTOMATIC and not is_lost:
        errors = [each for each in errors if each.type != ErrorType.NOT_AVAILABLE]
    if is_lost:
        errors.append(_NOT_LOCALIZED)
    return errors


def _error(error: VehicleError) -> dict[str, Any]:
    name = _ERROR_TYPES.get(error.type) or re.sub("(?<=[a-z])(?=[A-Z])", "_", error.type).upper()
    renamed = replace(error, references=tuple(map(_renamed, error.references)))
    return parts.error(renamed, name, _ERROR_LEVELS.get(name, error.level.value))


def _renamed(reference: Reference) -> Reference:
    """Return a reference with this version's name of the parameter that it names."""
    if reference.key != "parameter":
        return reference
    return replace(reference, value=_PARAMETERS.get(reference.value) or reference.value)


def _optional_parameter(parameter: OptionalParameter) -> dict[str, Any]:
    return parts.without_empty(
        {
            "parameter": _PARAMETERS.get(parameter.name, parameter.name),
            "support": "SUPPORTED",
            "description": parameter.description,
        }
    )


def _action_type(action: ActionType) -> dict[str, Any]:
    return parts.without_empty(
        {
            "actionType": action.name,
            "actionDescription": action.description,
            "actionScopes": parts.scopes(action.scopes),
            "actionParameters": parts.parameter_types(
                action.parameters, lambda name: _DATA_TYPES.get(name, name)
            ),
            "actionResult": action.result,
            "blockingTypes": sorted(each.value for each in action.blocking),
            "pauseAllowed": _TRUE if action.pausable else _FALSE,
            "cancelAllowed": _TRUE,
        }
    )
