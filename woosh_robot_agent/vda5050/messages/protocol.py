"""What the versions of the standard have in common: topics, headers, and their interface."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from enum import Enum
from typing import Any, ClassVar, NamedTuple, Protocol

from woosh_robot_agent.vda5050.messages.factsheet import Factsheet
from woosh_robot_agent.vda5050.messages.order import Action, Order
from woosh_robot_agent.vda5050.messages.state import (
    ConnectionState,
    RobotStatus,
    VehicleState,
)


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


class PublishOptions(NamedTuple):
    """QoS level and retain flag of a message."""

    qos: int
    retain: bool


PUBLISHED: Mapping[Topic, PublishOptions] = {
    Topic.STATE: PublishOptions(0, False),
    Topic.VISUALIZATION: PublishOptions(0, False),
    Topic.CONNECTION: PublishOptions(1, True),
    Topic.FACTSHEET: PublishOptions(0, True),
}
"""Publish options of the topics of the vehicle; they are the same in all versions."""


class Version(Protocol):
    """Messages of a version of the standard, without their headers.

    Attributes:
        number: number of the version, e.g. `2.1.0`.
        received: topics that the vehicle subscribes to.
        keeps_instant_actions: the states of instant actions stay in the state after a new order,
            until `clearInstantActions`.
        clears_lost_orders: an order is cleared when the robot does not know its position any more.
    """

    number: ClassVar[str]
    received: ClassVar[frozenset[Topic]]
    keeps_instant_actions: ClassVar[bool]
    clears_lost_orders: ClassVar[bool]

    def order(self, message: Mapping[str, Any]) -> Order:
        """Return the order in a message that fits the schema."""

    def instant_actions(self, message: Mapping[str, Any]) -> list[Action]:
        """Return the instant actions in a message that fits the schema."""

    def state(self, state: VehicleState) -> dict[str, Any]:
        """Return a `state` message."""

    def visualization(self, robot: RobotStatus, state_id: int) -> dict[str, Any]:
        """Return a `visualization` message.

        Args:
            robot: state of the robot.
            state_id: header id of the last state.
        """

    def connection(self, state: ConnectionState) -> dict[str, Any]:
        """Return a `connection` message."""

    def factsheet(self, factsheet: Factsheet) -> dict[str, Any]:
        """Return a `factsheet` message."""


_COUNT = 2**32
"""Number of header ids; after the last one, they start again at 0."""
_BLOCK = 1000
"""Number of header ids of a topic that are reserved at once."""


@dataclass(frozen=True)
class Identity:
    """Identity of a vehicle, in topics and headers.

    Attributes:
        manufacturer: manufacturer of the vehicle.
        serial_number: serial number; unique for the manufacturer.
    """

    manufacturer: str
    serial_number: str


class HeaderIds:
    """Header ids of a vehicle, counted for each topic.

    Ids are reserved in blocks, so that none is used again after a restart. If the program ends
    without `close`, the ids continue after the reserved block.

    Args:
        first: next id of each topic.
        save: saves the next id of each topic after a restart; called before the reserved ids are
            used.
    """

    def __init__(
        self,
        first: Mapping[str, int] | None = None,
        save: Callable[[Mapping[str, int]], None] = lambda numbers: None,
    ) -> None:
        self._next = Counter(first or {})
        self._reserved = Counter(self._next)
        """The first id of each topic that is not reserved."""
        self._save = save

    def next(self, topic: str) -> int:
        """Take the next id of a topic, and return it."""
        number = self._next[topic]
        self._take(topic, number + 1)
        return number

    def peek(self, topic: str) -> int:
        """Return the next id of a topic without taking it."""
        return self._next[topic]

    def close(self) -> None:
        """Save the exact ids; take none afterwards."""
        self._save(dict(self._next))

    def _take(self, topic: str, following: int) -> None:
        self._next[topic] = following % _COUNT
        if not 0 < self._reserved[topic] - self._next[topic] <= _BLOCK:
            self._reserved[topic] = self._next[topic] + _BLOCK
            self._save({name: number % _COUNT for name, number in self._reserved.items()})


def timestamp(unix: float) -> str:
    """Return a Unix time in ISO 8601, in UTC, with milliseconds."""
    when = datetime.fromtimestamp(unix, timezone.utc)
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def header(identity: Identity, version: str, header_id: int, unix: float) -> dict[str, Any]:
    """Return the header fields of a message."""
    return {
        "headerId": header_id,
        "timestamp": timestamp(unix),
        "version": version,
        "manufacturer": identity.manufacturer,
        "serialNumber": identity.serial_number,
    }
