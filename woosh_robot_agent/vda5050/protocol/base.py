"""Interface of a version of the standard."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

from woosh_robot_agent.vda5050.model.factsheet import Factsheet
from woosh_robot_agent.vda5050.model.order import Action, Order
from woosh_robot_agent.vda5050.model.state import (
    ConnectionState,
    RobotStatus,
    VehicleState,
)
from woosh_robot_agent.vda5050.protocol.topics import Topic


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
