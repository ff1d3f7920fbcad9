"""Version 2.1.0 of the standard."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from woosh_robot_agent.vda5050.messages import parts
from woosh_robot_agent.vda5050.messages.factsheet import ActionType, Factsheet
from woosh_robot_agent.vda5050.messages.order import (
    MAX_MESSAGE_SIZE,
    MAX_TEXT,
    Action,
    Edge,
    Node,
    NodePosition,
    Order,
)
from woosh_robot_agent.vda5050.messages.protocol import Topic
from woosh_robot_agent.vda5050.messages.state import (
    ActionState,
    ActionStatus,
    Battery,
    ConnectionState,
    ErrorType,
    RobotStatus,
    VehicleError,
    VehicleState,
)

_UNSUPPORTED_EDGE_FIELDS = (
    "corridor",
    "direction",
    "maxHeight",
    "maxRotationSpeed",
    "minHeight",
    "orientation",
    "rotationAllowed",
)
"""Fields of an edge that the robot cannot obey."""
_ALWAYS_OBEYED: Mapping[str, Callable[[Mapping[str, Any]], bool]] = {
    "orientation": parts.is_tangential,
    "rotationAllowed": lambda edge: edge["rotationAllowed"],
}
"""Functions that return True if such a field asks for what the robot does anyway: it turns where it
must, and drives forwards."""
_ERROR_TYPES: Mapping[str, str] = {
    ErrorType.UNSUPPORTED_PARAMETER: "orderError",
    ErrorType.ORDER_ACTION: "orderError",
    ErrorType.OTHER_ORDER_ACTIVE: "orderError",
    ErrorType.NOT_AVAILABLE: "orderError",
    ErrorType.UNKNOWN_MAP: "orderError",
    ErrorType.OUTDATED_UPDATE: "orderUpdateError",
    ErrorType.CHANGED_UPDATE: "orderUpdateError",
    ErrorType.UPDATE_AFTER_CANCEL: "orderUpdateError",
}
"""errorType of errors that this version does not distinguish; of others it is `ErrorType.value`."""
_STATUS = {ActionStatus.PAUSED: ActionStatus.RUNNING}
"""Substitutes for statuses that the published schema of the state lacks."""


class Version21:
    """Messages of version 2.1.0."""

    number: ClassVar[str] = "2.1.0"
    received: ClassVar[frozenset[Topic]] = frozenset({Topic.ORDER, Topic.INSTANT_ACTIONS})
    keeps_instant_actions: ClassVar[bool] = False
    clears_lost_orders: ClassVar[bool] = False

    # From the master control

    def order(self, message: Mapping[str, Any]) -> Order:
        return Order(
            id=message["orderId"],
            update_id=int(message["orderUpdateId"]),
            nodes=tuple(map(self._node, message["nodes"])),
            edges=tuple(map(self._edge, message["edges"])),
            unsupported=("zoneSetId",) if message.get("zoneSetId") else (),
        )

    def instant_actions(self, message: Mapping[str, Any]) -> list[Action]:
        return [_read_action(action) for action in message["actions"]]

    def _node(self, node: Mapping[str, Any]) -> Node:
        position = node.get("nodePosition")
        return Node(
            id=node["nodeId"],
            sequence_id=int(node["sequenceId"]),
            released=node["released"],
            position=None if position is None else self._node_position(position),
            actions=tuple(map(_read_action, node["actions"])),
            description=node.get("nodeDescription", ""),
        )

    def _node_position(self, position: Mapping[str, Any]) -> NodePosition:
        return NodePosition(
            x=position["x"],
            y=position["y"],
            map_id=position["mapId"],
            theta=position.get("theta"),
            deviation_xy=position.get("allowedDeviationXY", 0.0),
            deviation_theta=position.get("allowedDeviationTheta", 0.0),
        )

    def _edge(self, edge: Mapping[str, Any]) -> Edge:
        trajectory = edge.get("trajectory")
        return Edge(
            id=edge["edgeId"],
            sequence_id=int(edge["sequenceId"]),
            start_node_id=edge["startNodeId"],
            end_node_id=edge["endNodeId"],
            released=edge["released"],
            max_speed=edge.get("maxSpeed"),
            trajectory=None if trajectory is None else parts.read_trajectory(trajectory),
            actions=tuple(map(_read_action, edge["actions"])),
            description=edge.get("edgeDescription", ""),
            unsupported=parts.unsupported(edge, _UNSUPPORTED_EDGE_FIELDS, _ALWAYS_OBEYED),
        )

    # From the vehicle

    def state(self, state: VehicleState) -> dict[str, Any]:
        order, robot = state.order, state.robot
        message: dict[str, Any] = {
            "orderId": order.order_id,
            "orderUpdateId": order.update_id,
            "lastNodeId": order.last_node_id,
            "lastNodeSequenceId": order.last_node_sequence_id,
            "driving": robot.driving,
            "paused": order.paused,
            "newBaseRequest": order.new_base_request,
            "operatingMode": robot.mode.value,
            "nodeStates": [parts.node_state(each, "nodeDescription") for each in order.nodes],
            "edgeStates": [parts.edge_state(each, "edgeDescription") for each in order.edges],
            "actionStates": [_action_state(each) for each in order.actions],
            "batteryState": _battery(robot.battery),
            "errors": [_error(error) for error in state.errors],
            "safetyState": {
                "eStop": robot.emergency_stop.value,
                "fieldViolation": robot.field_violation,
            },
        }
        return message | parts.known_state(order, robot) | _motion(robot)

    def visualization(self, robot: RobotStatus, state_id: int) -> dict[str, Any]:
        return _motion(robot)

    def connection(self, state: ConnectionState) -> dict[str, Any]:
        return {"connectionState": state.value}

    def factsheet(self, factsheet: Factsheet) -> dict[str, Any]:
        return {
            "typeSpecification": parts.without_empty(
                {
                    "seriesName": factsheet.series,
                    "seriesDescription": factsheet.description,
                    "agvKinematic": factsheet.kinematics.value,
                    "agvClass": factsheet.vehicle_class.value,
                    "maxLoadMass": factsheet.max_load,
                    "localizationTypes": ["NATURAL"],
                    "navigationTypes": ["AUTONOMOUS", "VIRTUAL_LINE_GUIDED"],
                }
            ),
            "physicalParameters": {
                "speedMin": 0.0,
                "speedMax": factsheet.max_speed,
                "accelerationMax": factsheet.max_acceleration,
                "decelerationMax": factsheet.max_acceleration,
                "heightMax": factsheet.height,
                "width": factsheet.width,
                "length": factsheet.length,
            },
            "protocolLimits": {
                "maxStringLens": {"msgLen": MAX_MESSAGE_SIZE, "idLen": MAX_TEXT},
                "maxArrayLens": dict(parts.ARRAY_LIMITS),
                "timing": {
                    "minOrderInterval": 0.0,
                    "minStateInterval": factsheet.min_state_interval,
                    "defaultStateInterval": factsheet.state_interval,
                    "visualizationInterval": factsheet.visualization_interval,
                },
            },
            "protocolFeatures": {
                "optionalParameters": [
                    parts.without_empty(
                        {
                            "parameter": each.name,
                            "support": "SUPPORTED",
                            "description": each.description,
                        }
                    )
                    for each in factsheet.optional_parameters
                ],
                "agvActions": [_action_type(action) for action in factsheet.actions],
            },
            "agvGeometry": {
                "envelopes2d": [
                    {
                        "set": "outline",
                        "polygonPoints": [{"x": x, "y": y} for x, y in factsheet.outline],
                    }
                ]
                if factsheet.outline
                else []
            },
            "loadSpecification": {},
            "vehicleConfig": {
                "versions": [{"key": key, "value": value} for key, value in factsheet.versions]
            },
        }


def _read_action(action: Mapping[str, Any]) -> Action:
    return parts.read_action(action, "actionDescription")


def _action_state(action: ActionState) -> dict[str, Any]:
    status = _STATUS.get(action.status, action.status).value
    return parts.action_state(
        action, status, description="actionDescription", result="resultDescription"
    )


def _motion(robot: RobotStatus) -> dict[str, Any]:
    message: dict[str, Any] = {}
    if robot.position is not None:
        place = robot.position
        message["agvPosition"] = {
            "x": place.x,
            "y": place.y,
            "theta": parts.angle(place.theta),
            "mapId": place.map_id,
            "positionInitialized": place.initialised,
        }
    if robot.velocity is not None:
        message["velocity"] = parts.velocity(robot.velocity)
    return message


def _battery(battery: Battery) -> dict[str, Any]:
    state: dict[str, Any] = {"batteryCharge": battery.charge, "charging": battery.charging}
    if battery.health is not None:
        state["batteryHealth"] = battery.health
    return state


def _error(error: VehicleError) -> dict[str, Any]:
    return parts.error(error, _ERROR_TYPES.get(error.type, error.type), error.level.value)


def _action_type(action: ActionType) -> dict[str, Any]:
    # no blockingTypes, because no list of them fits the published schema
    return parts.without_empty(
        {
            "actionType": action.name,
            "actionDescription": action.description,
            "actionScopes": parts.scopes(action.scopes),
            "actionParameters": parts.parameter_types(action.parameters),
            "resultDescription": action.result,
        }
    )
