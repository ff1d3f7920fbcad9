"""Orders as they arrive: from bytes to an order that the vehicle can judge."""

from __future__ import annotations

from dataclasses import replace

from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.inbox import read_order
from woosh_robot_agent.vda5050.model.order import Order
from woosh_robot_agent.vda5050.order_check import OrderCheck
from woosh_robot_agent.vda5050.orders.mark_nodes import with_marks
from woosh_robot_agent.vda5050.protocol.base import Version
from woosh_robot_agent.vda5050.protocol.header import Identity
from woosh_robot_agent.vda5050.robot.facts import RobotFacts
from woosh_robot_agent.vda5050.robot.maps import MapLibrary
from woosh_robot_agent.vda5050.robot.marks import RobotMarks


class OrderIntake:
    """Reads and checks orders.

    Args:
        version: version of the standard.
        registry: the actions of the vehicle.
        facts: what the robot reports.
        marks: the marks of the robot.
        maps: the maps of the robot.
    """

    def __init__(
        self,
        version: Version,
        registry: Registry,
        facts: RobotFacts,
        marks: RobotMarks,
        maps: MapLibrary,
    ) -> None:
        self._version = version
        self._registry = registry
        self._facts = facts
        self._marks = marks
        self._maps = maps

    def read(self, payload: bytes, identity: Identity) -> Order:
        """Return a received order, with the marks to which the robot drives.

        Args:
            payload: the message.
            identity: identity of the vehicle.

        Raises:
            RejectedError: the message is malformed, or not for this vehicle.
        """
        order = read_order(payload, self._version, identity)
        status = self._facts.status
        place = status.position if status is not None else None
        return with_marks(order, "" if place is None else place.map_id, self._marks.find)

    def check(self, order: Order) -> None:
        """Check an order against what the vehicle can do now.

        Raises:
            RejectedError: the vehicle cannot perform it.
        """
        status, info = self._facts.status, self._facts.info
        if status is not None and info is not None:
            status = replace(status, maps=self._maps.listed(info))
        OrderCheck(order, self._registry).check(status)
