"""The state of a vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from woosh_robot_agent.vda5050.model.errors import VehicleError
from woosh_robot_agent.vda5050.model.order import Edge, Node


class OperatingMode(Enum):
    """Operating mode of a vehicle."""

    AUTOMATIC = "AUTOMATIC"
    MANUAL = "MANUAL"
    SERVICE = "SERVICE"
    TEACH_IN = "TEACHIN"


class EmergencyStop(Enum):
    """Emergency stop, by how it is acknowledged."""

    NONE = "NONE"
    """No emergency stop is active."""
    MANUAL = "MANUAL"
    """It must be acknowledged at the vehicle."""


class ActionStatus(Enum):
    """Status of an action."""

    WAITING = "WAITING"
    INITIALIZING = "INITIALIZING"
    RUNNING = "RUNNING"
    PAUSED = "PAUSED"
    FINISHED = "FINISHED"
    FAILED = "FAILED"

    @property
    def ended(self) -> bool:
        """True if the action has finished or failed."""
        return self in (ActionStatus.FINISHED, ActionStatus.FAILED)


class ConnectionState(Enum):
    """State of the connection between the vehicle and the broker."""

    ONLINE = "ONLINE"
    OFFLINE = "OFFLINE"
    BROKEN = "CONNECTIONBROKEN"


@dataclass(frozen=True)
class ActionState:
    """The state of an action.

    Attributes:
        id: id of the action.
        type: name of the action.
        status: its status.
        result: result or reason of a failure; may be empty.
        description: further information from the order; may be empty.
        instant: it was requested by an instantActions message.
    """

    id: str
    type: str
    status: ActionStatus
    result: str = ""
    description: str = ""
    instant: bool = False


@dataclass(frozen=True)
class Position:
    """Position of the vehicle.

    Attributes:
        x: position in the map frame, in metres.
        y: position in the map frame, in metres.
        theta: heading, in radians.
        map_id: id of the map.
        initialised: the vehicle knows its position.
    """

    x: float
    y: float
    theta: float
    map_id: str
    initialised: bool


@dataclass(frozen=True)
class Velocity:
    """Velocity of the vehicle: forward in m/s, and turn rate in rad/s."""

    vx: float
    omega: float


@dataclass(frozen=True)
class Battery:
    """State of the battery.

    Attributes:
        charge: charge, in percent.
        charging: the battery is being charged.
        health: health, in percent; None if the robot does not report it.
    """

    charge: float
    charging: bool
    health: float | None = None


@dataclass(frozen=True)
class Map:
    """A map on the vehicle.

    Attributes:
        id: id of the map.
        version: version of its data; may be empty.
        enabled: the vehicle uses it now.
    """

    id: str
    version: str
    enabled: bool


@dataclass(frozen=True)
class OrderStatus:
    """Progress of an order.

    Attributes:
        order_id: id of the current or last order; empty without any.
        update_id: number of its last update.
        last_node_id: id of the last node that was reached; empty without any.
        last_node_sequence_id: its sequence id.
        nodes: nodes still to be reached, the horizon included.
        edges: edges still to be left, the horizon included.
        actions: states of the actions.
        paused: the vehicle is paused.
        new_base_request: the vehicle is about to reach the end of the base.
        distance_since_last_node: distance driven since the last node, in metres; None if unknown.
    """

    order_id: str = ""
    update_id: int = 0
    last_node_id: str = ""
    last_node_sequence_id: int = 0
    nodes: tuple[Node, ...] = ()
    edges: tuple[Edge, ...] = ()
    actions: tuple[ActionState, ...] = ()
    paused: bool = False
    new_base_request: bool = False
    distance_since_last_node: float | None = None


@dataclass(frozen=True)
class RobotStatus:
    """State of the robot, from its reports.

    Attributes:
        driving: the robot drives or turns.
        mode: operating mode.
        battery: state of the battery.
        emergency_stop: the active emergency stop.
        field_violation: an obstacle is in the protective field.
        position: position; None if the robot did not report one.
        velocity: velocity; None if the robot did not report one.
        loaded: the robot carries a load; None if it does not detect loads.
        maps: maps on the robot; None if unknown.
        errors: errors of the robot.
        blocked: the robot stands before an obstacle.
        path: points of the path that the robot follows, in metres; empty without one.
    """

    driving: bool
    mode: OperatingMode
    battery: Battery
    emergency_stop: EmergencyStop
    field_violation: bool
    position: Position | None = None
    velocity: Velocity | None = None
    loaded: bool | None = None
    maps: tuple[Map, ...] | None = None
    errors: tuple[VehicleError, ...] = ()
    blocked: bool = False
    path: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class VehicleState:
    """The complete state of a vehicle.

    Attributes:
        order: progress of the order.
        robot: state of the robot.
        errors: errors about orders and actions, and those of the robot.
    """

    order: OrderStatus
    robot: RobotStatus
    errors: tuple[VehicleError, ...] = ()
