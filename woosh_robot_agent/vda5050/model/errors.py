"""Errors and information that a vehicle reports in its state."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from woosh_robot_agent.vda5050.model.order import Order


class ErrorLevel(Enum):
    """Severity of an error."""

    WARNING = "WARNING"
    """The vehicle goes on."""
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
    """The vehicle is in an operating mode in which it takes no orders."""
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
    """The robot did not reach the next node."""
    INSTANT_ACTION = "instantActionError"
    """The vehicle cannot perform an instant action."""
    ACTION = "actionError"
    """An action failed."""
    DUPLICATE_MAP = "duplicateMap"
    """The vehicle has the map already."""
    INTERRUPTED = "interruptedError"
    """The order was interrupted by a restart of the connector, or by people at the robot."""
    ROBOT_CONNECTION = "robotConnectionError"
    """The connector has no link to the robot."""
    ROBOT_BUSY = "robotBusyError"
    """The order waits: something else drives the robot, or the robot charges."""
    OBSTACLE = "obstacleError"
    """An obstacle blocks the way of the robot, which waits until it is gone."""
    SECOND_CONNECTOR = "secondConnectorError"
    """Another connector uses the topics of the vehicle."""
    STATE_FILE = "stateFileError"
    """The state file cannot be used."""


@dataclass(frozen=True)
class Reference:
    """A reference from an error to what it is about.

    Attributes:
        key: name of the field, e.g. `orderId`.
        value: its value.
    """

    key: str
    value: str


@dataclass(frozen=True)
class VehicleError:
    """An error in the state of a vehicle.

    Attributes:
        type: type of the error.
        level: severity.
        description: what happened.
        hint: what to do about it; may be empty.
        references: what the error is about.
    """

    type: str
    level: ErrorLevel
    description: str
    hint: str = ""
    references: tuple[Reference, ...] = ()


class RejectedError(Exception):
    """An order or an action is rejected.

    Attributes:
        error: the error to report.
    """

    def __init__(self, error: VehicleError) -> None:
        super().__init__(error.description)
        self.error = error


def warning(
    kind: ErrorType, description: str, hint: str = "", **references: object
) -> VehicleError:
    """Return a warning. Keyword arguments are its references; a list gives one for each item."""
    return VehicleError(
        kind.value,
        ErrorLevel.WARNING,
        description,
        hint,
        tuple(
            Reference(key, str(each))
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
