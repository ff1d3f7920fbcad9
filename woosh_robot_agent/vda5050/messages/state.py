"""The state of the vehicle, with its errors and information."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.messages.order import Edge, Node, Order

ROBOT_REFUSED = Sentence("the robot refused {what}: {reason}")
"""Reason of a failure: a refusal, with the robot's text."""
WITH_TEXT = Sentence("{reason}: {text}")
"""Reason of a failure that is not a refusal, with the robot's text."""
NOT_AUTOMATIC = Sentence("the robot is not in automatic mode")
"""Reason why nothing that moves the robot is performed."""
NO_STATE = Sentence("the robot has not reported its state yet")
"""Reason of a failure before the first report of the robot."""
NO_POSITION = Sentence("the robot does not know its position")
"""Reason why nothing that needs the position of the robot is performed."""
NOT_READ = Sentence("the robot has not sent its maps and marks yet")
"""Reason why nothing that needs a map or mark of the robot is performed."""


class ErrorLevel(Enum):
    """Severity of an error."""

    WARNING = "WARNING"
    """The vehicle goes on."""
    CRITICAL = "CRITICAL"
    """The vehicle cannot go on with its order, but can take a new one."""
    FATAL = "FATAL"
    """The vehicle cannot go on without help."""


class ErrorType(str, Enum):
    """Types of errors of the connector. Each version of the standard may name them differently."""

    VALIDATION = "validationError"
    """A message is malformed."""
    ORDER = "orderError"
    """The vehicle cannot perform the order."""
    UNSUPPORTED_PARAMETER = "unsupportedParameter"
    """The vehicle cannot obey an optional field of the order."""
    ORDER_ACTION = "orderActionError"
    """The vehicle cannot perform an action of the order."""
    OTHER_ORDER_ACTIVE = "otherOrderActive"
    """The vehicle still executes another order."""
    NOT_AVAILABLE = "notAvailable"
    """The vehicle cannot take or continue an order, because of its mode or unknown position."""
    UNKNOWN_MAP = "unknownMap"
    """A node is on a map that the vehicle does not have."""
    NO_ROUTE = "noRouteError"
    """The vehicle is too far away from the first node of the order."""
    ORDER_UPDATE = "orderUpdateError"
    """The order update does not fit the current order."""
    OUTDATED_UPDATE = "outdatedUpdate"
    """The vehicle has a later update of the order."""
    CHANGED_UPDATE = "changedUpdate"
    """The vehicle has an update with the same number and different content."""
    UPDATE_AFTER_CANCEL = "updateAfterCancel"
    """The order of the update was cancelled."""
    NO_ORDER_TO_CANCEL = "noOrderToCancel"
    """There is no order that could be cancelled."""
    DRIVING = "drivingError"
    """The robot did not reach the next node, or cannot drive to it."""
    INSTANT_ACTION = "instantActionError"
    """The vehicle cannot perform an instant action."""
    ACTION = "actionError"
    """An action failed."""
    DUPLICATE_MAP = "duplicateMap"
    """The vehicle has the map already."""
    INTERRUPTED = "interruptedError"
    """The order was interrupted, e.g. by a restart of the connector or by people at the robot."""
    ROBOT_CONNECTION = "robotConnectionError"
    """The connector has no link to the robot."""
    ROBOT_BUSY = "robotBusyError"
    """The order waits: something else drives the robot, or the robot charges."""
    OBSTACLE = "obstacleError"
    """An obstacle blocks the way of the robot, which waits until the obstacle is gone."""
    SECOND_CONNECTOR = "secondConnectorError"
    """Another connector uses the topics of the vehicle."""
    STATE_FILE = "stateFileError"
    """The state file cannot be used."""


@dataclass(frozen=True)
class VehicleError:
    """An error in the state of a vehicle.

    Attributes:
        type: value of an `ErrorType`, or another type in the standard's spelling.
        hint: how to remove the cause; may be empty.
        references: keys such as `orderId`, each with its value; a key may occur several times.
    """

    type: str
    level: ErrorLevel
    description: str
    hint: str = ""
    references: tuple[tuple[str, str], ...] = ()


class RejectedError(Exception):
    """A message of the master control is rejected.

    Attributes:
        error: the error that the state reports.
    """

    def __init__(self, error: VehicleError) -> None:
        super().__init__(error.description)
        self.error = error


class ActionFailedError(Exception):
    """An action failed. The text is the reason.

    Args:
        kind: type of the error in the state that reports the failure.
    """

    def __init__(self, reason: str, kind: ErrorType = ErrorType.ACTION) -> None:
        super().__init__(reason)
        self.kind = kind


def warning(
    kind: ErrorType, description: str, hint: str = "", **references: object
) -> VehicleError:
    """Return a warning. Keyword arguments are its references; a list gives a reference per item."""
    return VehicleError(
        kind.value,
        ErrorLevel.WARNING,
        description,
        hint,
        tuple(
            (key, str(each))
            for key, value in references.items()
            for each in (value if isinstance(value, list) else [value])
        ),
    )


def rejection(
    kind: ErrorType, order: Order, description: str, hint: str, **references: object
) -> RejectedError:
    """Return the exception that rejects an order, with references to the order and others."""
    error = warning(
        kind, description, hint, orderId=order.id, orderUpdateId=order.update_id, **references
    )
    return RejectedError(error)


class OperatingMode(Enum):
    """Operating mode of a vehicle."""

    AUTOMATIC = "AUTOMATIC"
    MANUAL = "MANUAL"
    SERVICE = "SERVICE"
    TEACH_IN = "TEACHIN"


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
        result: result or reason of a failure; may be empty.
        description: further information from the order; may be empty.
    """

    id: str
    type: str
    status: ActionStatus
    result: str = ""
    description: str = ""


@dataclass(frozen=True)
class Position:
    """Position of the vehicle.

    Attributes:
        x: position in the map frame, in metres.
        y: position in the map frame, in metres.
        theta: heading, in radians.
        initialised: True if the vehicle knows its position.
    """

    x: float
    y: float
    theta: float
    map_id: str
    initialised: bool

    @property
    def point(self) -> tuple[float, float]:
        """The place without the heading, in metres."""
        return self.x, self.y


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
        health: health, in percent; None if the robot does not report it.
    """

    charge: float
    charging: bool
    health: float | None = None


@dataclass(frozen=True)
class Map:
    """A map on the vehicle.

    Attributes:
        version: version of the map's data; may be empty.
        enabled: True if the vehicle uses the map now.
    """

    id: str
    version: str
    enabled: bool


@dataclass(frozen=True)
class OrderStatus:
    """Progress of an order.

    Attributes:
        order_id: id of the current or last order; empty before the first order.
        update_id: number of the order's last update.
        last_node_id: id of the last node that was reached; empty if there is none.
        last_node_sequence_id: its sequence id; 0 if there is none.
        nodes: nodes still to be reached, the horizon included.
        edges: edges still to be traversed, the horizon and the current edge included.
        new_base_request: True if the vehicle needs more of the horizon released, because it is
            about to reach the end of the base.
        distance_since_last_node: distance driven since the last node, in metres; None if unknown.
    """

    order_id: str = ""
    update_id: int = 0
    last_node_id: str = ""
    last_node_sequence_id: int = 0
    nodes: tuple[Node, ...] = ()
    edges: tuple[Edge, ...] = ()
    actions: tuple[ActionState, ...] = ()
    new_base_request: bool = False
    distance_since_last_node: float | None = None


@dataclass(frozen=True)
class RobotStatus:
    """State of the robot, from its reports.

    Attributes:
        driving: True if the robot drives or turns.
        emergency_stop: True while an emergency stop is active, which must be acknowledged at the
            vehicle.
        field_violation: True while an obstacle is in the protective field.
        position: position; None if the robot did not report a position.
        velocity: velocity; None if the robot did not report a velocity.
        loaded: True if the robot carries a load; None if it does not detect loads.
        maps: maps on the robot; None if unknown.
        blocked: True while an obstacle is in the way of the robot.
        path: points of the path that the robot follows, in the map frame, in metres; empty without
            a path.
    """

    driving: bool
    mode: OperatingMode
    battery: Battery
    emergency_stop: bool
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
        paused: True while the vehicle is paused.
        errors: errors of orders, actions, the connector and the robot.
    """

    order: OrderStatus
    robot: RobotStatus
    instant_actions: tuple[ActionState, ...]
    paused: bool
    errors: tuple[VehicleError, ...]
