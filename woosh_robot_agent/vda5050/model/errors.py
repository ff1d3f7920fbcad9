"""Errors and information that a vehicle reports in its state."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class ErrorLevel(Enum):
    """Severity of an error."""

    WARNING = "WARNING"
    """The vehicle goes on."""
    FATAL = "FATAL"
    """The vehicle cannot go on without help."""


class ErrorType(str, Enum):
    """Types of errors about orders and instant actions."""

    VALIDATION = "validationError"
    """A message is malformed."""
    ORDER = "orderError"
    """The vehicle cannot perform the order."""
    ORDER_UPDATE = "orderUpdateError"
    """The order update does not fit the current order."""
    NO_ROUTE = "noRouteError"
    """The vehicle is too far away from the first node of the order."""
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
    """Something else than the order drives the robot."""
    SECOND_CONNECTOR = "secondConnectorError"
    """Another connector uses the topics of the vehicle."""
    STATE_FILE = "stateFileError"
    """The file with the order cannot be used."""


@dataclass(frozen=True)
class Reference:
    """A reference to what an error is about.

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
    """Return a warning whose references are the keyword arguments."""
    return VehicleError(
        kind.value,
        ErrorLevel.WARNING,
        description,
        hint,
        tuple(Reference(key, str(value)) for key, value in references.items()),
    )
