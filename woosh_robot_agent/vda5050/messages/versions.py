"""The versions of the standard: their topics, and tables of the differences, e.g. field names.

Inside the connector, fields have the names of version 2.1. `reading` and `writing` translate the
names by these tables. Differences that no table can express depend on `Version.is_3`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from enum import Enum
from typing import Any

from woosh_robot_agent.vda5050.messages.state import ErrorType


class Topic(Enum):
    """Last level of a topic."""

    ORDER = "order"
    INSTANT_ACTIONS = "instantActions"
    STATE = "state"
    VISUALIZATION = "visualization"
    CONNECTION = "connection"
    FACTSHEET = "factsheet"
    ZONE_SET = "zoneSet"
    """From version 3.0 on."""


PUBLISHED: Mapping[Topic, tuple[int, bool]] = {
    Topic.STATE: (0, False),
    Topic.VISUALIZATION: (0, False),
    Topic.CONNECTION: (1, True),
    Topic.FACTSHEET: (0, True),
}
"""Topics of the vehicle, in all versions, with QoS level, and True if messages are retained."""


@dataclass(frozen=True)
class Identity:
    """Identity of a vehicle, in topics and headers.

    Attributes:
        serial_number: serial number; unique for the manufacturer.
    """

    manufacturer: str
    serial_number: str


def timestamp(unix: float) -> str:
    """Return a Unix time in ISO 8601, in UTC, with milliseconds."""
    when = datetime.fromtimestamp(unix, timezone.utc)
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _is_tangential(edge: Mapping[str, Any]) -> bool:
    """Return True if the vehicle must drive forwards: with orientation 0 along the edge."""
    return not edge["orientation"] and edge.get("orientationType", "TANGENTIAL") == "TANGENTIAL"


OBEYED_ANYWAY: Mapping[str, Callable[[Mapping[str, Any]], bool]] = {
    "orientation": _is_tangential,
    "rotationAllowed": lambda edge: bool(edge["rotationAllowed"]),
    "reachOrientationBeforeEntering": lambda edge: not edge["reachOrientationBeforeEntering"],
}
"""Unsupported fields of an edge that may demand only what the robot does anyway: to turn where it
must, and to drive forwards. The function of a field returns True if an edge demands only that."""


@dataclass(frozen=True)
class Version:
    """A version of the standard.

    Attributes:
        number: number of the version, e.g. `2.1.0`.
        received: topics of the master control that the vehicle subscribes to.
        names: names of fields and actions by their names in version 2.1, where they differ;
            empty for a field that this version does not have.
        values: values of enumerations by their values in the connector, where they differ.
        unsupported_edge_fields: fields of an edge that the robot cannot obey; see also
            `OBEYED_ANYWAY`.
        error_types: errorType by `ErrorType`, where `error_type` cannot derive it; empty for an
            error that does not occur in this version.
        error_levels: errorLevel of errors, by their errorType, where the standard prescribes
            another level than `VehicleError.level`.
    """

    number: str
    received: frozenset[Topic]
    unsupported_edge_fields: tuple[str, ...]
    names: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, str] = field(default_factory=dict)
    error_types: Mapping[str, str] = field(default_factory=dict)
    error_levels: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_3(self) -> bool:
        """True for version 3.

        In version 3, an update of an order that the vehicle does not have is rejected, the states
        of instant actions stay in the state after a new order, until `clearInstantActions`, and a
        drive is paused while the robot does not know its position. For the differences between
        messages see `reading` and `writing`.
        """
        return self.number.startswith("3.")

    def name(self, name: str) -> str:
        """Return this version's name of a field or action; empty if it does not have the field."""
        return self.names.get(name, name)

    def value(self, value: str) -> str:
        """Return this version's name of a value of an enumeration."""
        return self.values.get(value, value)

    def error_type(self, kind: str) -> str:
        """Return the errorType for a type of errors; in version 3, it is in capitals.

        Return an empty text for an error that does not occur in this version.
        """
        if kind in self.error_types:
            return self.error_types[kind]
        return re.sub("(?<=[a-z])(?=[A-Z])", "_", kind).upper() if self.is_3 else kind


V2_1 = Version(
    number="2.1.0",
    received=frozenset({Topic.ORDER, Topic.INSTANT_ACTIONS}),
    unsupported_edge_fields=(
        "corridor",
        "direction",
        "maxHeight",
        "maxRotationSpeed",
        "minHeight",
        "orientation",
        "rotationAllowed",
    ),
    values={"PAUSED": "RUNNING", "CRITICAL": "FATAL"},  # its schema lacks these
    error_types={
        ErrorType.UNSUPPORTED_PARAMETER: "orderError",
        ErrorType.ORDER_ACTION: "orderError",
        ErrorType.OTHER_ORDER_ACTIVE: "orderError",
        ErrorType.NOT_AVAILABLE: "orderError",
        ErrorType.UNKNOWN_MAP: "orderError",
        ErrorType.OUTDATED_UPDATE: "orderUpdateError",
        ErrorType.CHANGED_UPDATE: "",  # such an update is ignored
        ErrorType.UPDATE_AFTER_CANCEL: "orderUpdateError",
    },
)

V3_0 = Version(
    number="3.0.0",
    received=frozenset({Topic.ORDER, Topic.INSTANT_ACTIONS, Topic.ZONE_SET}),
    unsupported_edge_fields=(
        "corridor",
        "direction",
        "maximumMobileRobotHeight",
        "maximumRotationSpeed",
        "maxRotationSpeed",  # its name in the published schema
        "minimumLoadHandlingDeviceHeight",
        "orientation",
        "reachOrientationBeforeEntering",
    ),
    names={
        # order, state and visualization
        "actionDescription": "actionDescriptor",
        "agvPosition": "mobileRobotPosition",
        "batteryCharge": "stateOfCharge",
        "batteryState": "powerSupply",
        "eStop": "activeEmergencyStop",
        "edgeDescription": "edgeDescriptor",
        "maxSpeed": "maximumSpeed",
        "nodeDescription": "nodeDescriptor",
        "positionInitialized": "localized",
        "resultDescription": "actionResult",
        # factsheet
        "accelerationMax": "maximumAcceleration",
        "agvActions": "mobileRobotActions",
        "agvClass": "mobileRobotClass",
        "agvGeometry": "mobileRobotGeometry",
        "agvKinematic": "mobileRobotKinematics",
        "decelerationMax": "maximumDeceleration",
        "heightMax": "maximumHeight",
        "heightMin": "minimumHeight",
        "idLen": "maximumIdLength",
        "maxArrayLens": "maximumArrayLengths",
        "maxLoadMass": "maximumLoadMass",
        "maxStringLens": "maximumStringLengths",
        "minOrderInterval": "minimumOrderInterval",
        "minStateInterval": "minimumStateInterval",
        "msgLen": "maximumMessageLength",
        "polygonPoints": "vertices",
        "set": "envelope2dId",
        "speedMax": "maximumSpeed",
        "speedMin": "minimumSpeed",
        "vehicleConfig": "mobileRobotConfiguration",
        # actions that are named in the hints of errors
        "initPosition": "initializePosition",
        # optional parameters in the factsheet
        "order.edges.maxSpeed": "order.edges.maximumSpeed",
        "order.edges.rotationAllowed": "",
    },
    values={
        "AUTONOMOUS": "FREELY_NAVIGATING",
        "CONNECTIONBROKEN": "CONNECTION_BROKEN",
        "DIFF": "DIFFERENTIAL",
        "FLOAT": "NUMBER",
        "OMNI": "OMNIDIRECTIONAL",
        "TEACHIN": "TEACH_IN",
    },
    error_types={
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
    },
    error_levels={"UNSUPPORTED_PARAMETER": "CRITICAL", "NODE_UNREACHABLE": "CRITICAL"},
)

VERSIONS: Mapping[str, Version] = {"2.1": V2_1, "3.0": V3_0}
"""Versions, by the value of `--version`."""
