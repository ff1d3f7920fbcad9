"""Version 2.1.0 of the standard."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar

from woosh_robot_agent.vda5050.model.errors import ErrorType, VehicleError
from woosh_robot_agent.vda5050.model.factsheet import ActionType, Factsheet, Scope
from woosh_robot_agent.vda5050.model.order import (
    Action,
    BlockingType,
    ControlPoint,
    Edge,
    Node,
    NodePosition,
    Order,
    Trajectory,
)
from woosh_robot_agent.vda5050.model.state import (
    ActionState,
    ActionStatus,
    Battery,
    ConnectionState,
    Load,
    Position,
    RobotStatus,
    VehicleState,
    Velocity,
)
from woosh_robot_agent.vda5050.protocol.topics import Quality, Topic

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
    "orientation": lambda edge: (
        not edge["orientation"] and edge.get("orientationType", "TANGENTIAL") == "TANGENTIAL"
    ),
    "rotationAllowed": lambda edge: edge["rotationAllowed"],
}
"""Values of such fields that ask for what the robot does anyway: it turns, and drives forwards."""
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
"""Names of errors that this version does not distinguish; the others are `ErrorType.value`."""
_STATUS = {ActionStatus.PAUSED: ActionStatus.RUNNING}
"""Statuses that the published schema of the state lacks, and those that take their place."""


class Version21:
    """Messages of version 2.1.0."""

    number: ClassVar[str] = "2.1.0"
    quality: ClassVar[Mapping[Topic, Quality]] = {
        Topic.STATE: Quality(0, False),
        Topic.VISUALIZATION: Quality(0, False),
        Topic.CONNECTION: Quality(1, True),
        Topic.FACTSHEET: Quality(0, True),
    }

    # From the master control

    def order(self, message: Mapping[str, Any]) -> Order:
        return Order(
            id=message["orderId"],
            update_id=message["orderUpdateId"],
            nodes=tuple(map(self._node, message["nodes"])),
            edges=tuple(map(self._edge, message["edges"])),
            unsupported=("zoneSetId",) if message.get("zoneSetId") else (),
        )

    def instant_actions(self, message: Mapping[str, Any]) -> list[Action]:
        return [self._action(action) for action in message["actions"]]

    def _node(self, node: Mapping[str, Any]) -> Node:
        position = node.get("nodePosition")
        return Node(
            id=node["nodeId"],
            sequence_id=node["sequenceId"],
            released=node["released"],
            position=None if position is None else self._node_position(position),
            actions=tuple(map(self._action, node["actions"])),
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
            sequence_id=edge["sequenceId"],
            start_node_id=edge["startNodeId"],
            end_node_id=edge["endNodeId"],
            released=edge["released"],
            max_speed=edge.get("maxSpeed"),
            trajectory=None if trajectory is None else self._trajectory(trajectory),
            actions=tuple(map(self._action, edge["actions"])),
            description=edge.get("edgeDescription", ""),
            unsupported=_unsupported_edge_fields(edge),
        )

    def _trajectory(self, trajectory: Mapping[str, Any]) -> Trajectory:
        return Trajectory(
            degree=trajectory["degree"],
            knots=tuple(trajectory["knotVector"]),
            points=tuple(
                ControlPoint(point["x"], point["y"], point.get("weight", 1.0))
                for point in trajectory["controlPoints"]
            ),
        )

    def _action(self, action: Mapping[str, Any]) -> Action:
        return Action(
            id=action["actionId"],
            type=action["actionType"],
            blocking=BlockingType(action["blockingType"]),
            parameters={each["key"]: each["value"] for each in action.get("actionParameters", ())},
            description=action.get("actionDescription", ""),
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
            "nodeStates": [_node_state(node) for node in order.nodes],
            "edgeStates": [_edge_state(edge) for edge in order.edges],
            "actionStates": [_action_state(action) for action in order.actions],
            "batteryState": _battery(robot.battery),
            "errors": [_error(error) for error in state.errors],
            "safetyState": {
                "eStop": robot.emergency_stop.value,
                "fieldViolation": robot.field_violation,
            },
        }
        if order.distance_since_last_node is not None:
            message["distanceSinceLastNode"] = round(order.distance_since_last_node, 3)
        return message | self.visualization(robot.position, robot.velocity) | _optional(robot)

    def visualization(self, position: Position | None, velocity: Velocity | None) -> dict[str, Any]:
        message: dict[str, Any] = {}
        if position is not None:
            message["agvPosition"] = {
                "x": position.x,
                "y": position.y,
                "theta": position.theta,
                "mapId": position.map_id,
                "positionInitialized": position.initialised,
            }
        if velocity is not None:
            message["velocity"] = {"vx": velocity.vx, "vy": 0.0, "omega": velocity.omega}
        return message

    def connection(self, state: ConnectionState) -> dict[str, Any]:
        return {"connectionState": state.value}

    def factsheet(self, factsheet: Factsheet) -> dict[str, Any]:
        return {
            "typeSpecification": _without_empty(
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
                "maxStringLens": {},
                "maxArrayLens": {},
                "timing": {
                    "minOrderInterval": 0.0,
                    "minStateInterval": factsheet.min_state_interval,
                    "defaultStateInterval": factsheet.state_interval,
                    "visualizationInterval": factsheet.visualization_interval,
                },
            },
            "protocolFeatures": {
                "optionalParameters": [
                    _without_empty(
                        {
                            "parameter": each.name,
                            "support": "REQUIRED" if each.required else "SUPPORTED",
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


def _unsupported_edge_fields(edge: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the fields that the robot cannot obey."""
    return tuple(
        name
        for name in _UNSUPPORTED_EDGE_FIELDS
        if name in edge and not (name in _ALWAYS_OBEYED and _ALWAYS_OBEYED[name](edge))
    )


def _node_state(node: Node) -> dict[str, Any]:
    state: dict[str, Any] = {
        "nodeId": node.id,
        "sequenceId": node.sequence_id,
        "released": node.released,
    }
    if node.description:
        state["nodeDescription"] = node.description
    if node.position is not None:
        place = node.position
        state["nodePosition"] = {"x": place.x, "y": place.y, "mapId": place.map_id}
        if place.theta is not None:
            state["nodePosition"]["theta"] = place.theta
    return state


def _edge_state(edge: Edge) -> dict[str, Any]:
    state: dict[str, Any] = {
        "edgeId": edge.id,
        "sequenceId": edge.sequence_id,
        "released": edge.released,
    }
    if edge.description:
        state["edgeDescription"] = edge.description
    return state


def _action_state(action: ActionState) -> dict[str, Any]:
    return _without_empty(
        {
            "actionId": action.id,
            "actionType": action.type,
            "actionStatus": _STATUS.get(action.status, action.status).value,
            "actionDescription": action.description,
            "resultDescription": action.result,
        }
    )


def _battery(battery: Battery) -> dict[str, Any]:
    state: dict[str, Any] = {"batteryCharge": battery.charge, "charging": battery.charging}
    if battery.health is not None:
        state["batteryHealth"] = battery.health
    return state


def _error(error: VehicleError) -> dict[str, Any]:
    return _without_empty(
        {
            "errorType": _ERROR_TYPES.get(error.type, error.type),
            "errorLevel": error.level.value,
            "errorDescription": error.description,
            "errorHint": error.hint,
            "errorReferences": [
                {"referenceKey": each.key, "referenceValue": each.value}
                for each in error.references
            ],
        }
    )


def _optional(robot: RobotStatus) -> dict[str, Any]:
    message: dict[str, Any] = {}
    if robot.loads is not None:
        message["loads"] = [_load(load) for load in robot.loads]
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


def _load(load: Load) -> dict[str, Any]:
    message = _without_empty({"loadType": load.type})
    if load.id is not None:
        message["loadId"] = load.id
    return message


def _action_type(action: ActionType) -> dict[str, Any]:
    # the schema of blockingTypes cannot be fulfilled, so it is left out
    return _without_empty(
        {
            "actionType": action.name,
            "actionDescription": action.description,
            "actionScopes": _scopes(action.scopes),
            "actionParameters": [
                {
                    "key": each.key,
                    "valueDataType": each.type,
                    "description": each.description,
                    "isOptional": each.optional,
                }
                for each in action.parameters
            ],
            "resultDescription": action.result,
        }
    )


def _scopes(scopes: Iterable[Scope]) -> list[str]:
    return sorted(scope.value for scope in scopes)


def _without_empty(message: dict[str, Any]) -> dict[str, Any]:
    """Return a message without its empty texts and lists."""
    return {key: value for key, value in message.items() if value not in ("", [])}
