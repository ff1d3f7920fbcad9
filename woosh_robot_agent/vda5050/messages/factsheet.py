"""The factsheet: properties and capabilities of a vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from woosh_robot_agent.vda5050.messages.order import BlockingType

STANDSTILL = frozenset({BlockingType.SOFT, BlockingType.HARD})
"""Blocking types for actions that need a standing vehicle."""


class Kinematics(Enum):
    """Kinematics of a vehicle."""

    DIFFERENTIAL = "DIFF"
    OMNIDIRECTIONAL = "OMNI"


class VehicleClass(Enum):
    """Class of a vehicle: its purpose."""

    CARRIER = "CARRIER"
    CONVEYOR = "CONVEYOR"
    TUGGER = "TUGGER"


class Scope(Enum):
    """Places where an action may be requested."""

    INSTANT = "INSTANT"
    NODE = "NODE"
    EDGE = "EDGE"


@dataclass(frozen=True)
class ParameterType:
    """A parameter of an action.

    Attributes:
        key: name of the parameter.
        type: data type, e.g. `FLOAT`.
        description: meaning and unit.
        optional: True if it may be left out.
    """

    key: str
    type: str
    description: str
    optional: bool = False


@dataclass(frozen=True)
class ActionType:
    """An action that the vehicle can perform.

    Attributes:
        name: name of the action, e.g. `pick`.
        scopes: where it may be requested.
        description: what it does.
        parameters: its parameters.
        result: meaning of the result; empty if there is none.
        blocking: blocking types that it may have on nodes and edges.
        pausable: it moves something; it is paused with the vehicle.
        repeatable: as an instant action, it may have the id of one that has ended.
    """

    name: str
    scopes: frozenset[Scope]
    description: str
    parameters: tuple[ParameterType, ...] = ()
    result: str = ""
    blocking: frozenset[BlockingType] = frozenset(BlockingType)
    pausable: bool = False
    repeatable: bool = False


@dataclass(frozen=True)
class OptionalParameter:
    """An optional field of the standard that the vehicle obeys.

    Attributes:
        name: full name, e.g. `order.edges.maxSpeed`.
        description: further information.
    """

    name: str
    description: str = ""


@dataclass(frozen=True)
class Factsheet:
    """Properties and capabilities of a vehicle. Lengths are in metres, masses in kilograms.

    Attributes:
        series: name of the model.
        description: description of the model; may be empty.
        kinematics: how it can move.
        vehicle_class: what it is made for.
        max_load: maximum mass of the load.
        length: length of the vehicle.
        width: width of the vehicle.
        height: height of the vehicle.
        max_speed: maximum speed, in m/s.
        max_acceleration: maximum acceleration, in m/s².
        outline: corners of the outline in the vehicle's frame.
        actions: actions that it can perform.
        optional_parameters: optional fields that it obeys.
        min_state_interval: minimum time between two states, in seconds.
        state_interval: maximum time between two states, in seconds.
        visualization_interval: time between two visualizations while it moves, in seconds.
        versions: versions of its software, by name.
    """

    series: str
    description: str
    kinematics: Kinematics
    vehicle_class: VehicleClass
    max_load: float
    length: float
    width: float
    height: float
    max_speed: float
    max_acceleration: float
    outline: tuple[tuple[float, float], ...]
    actions: tuple[ActionType, ...]
    optional_parameters: tuple[OptionalParameter, ...]
    min_state_interval: float
    state_interval: float
    visualization_interval: float
    versions: tuple[tuple[str, str], ...] = ()
