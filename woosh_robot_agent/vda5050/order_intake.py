"""Orders as they arrive: from bytes to an order that the vehicle can judge."""

from __future__ import annotations

from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.inbox import read_order
from woosh_robot_agent.vda5050.model.order import Order
from woosh_robot_agent.vda5050.order_check import OrderCheck
from woosh_robot_agent.vda5050.orders.mark_nodes import with_marks
from woosh_robot_agent.vda5050.protocol.base import Version
from woosh_robot_agent.vda5050.robot.facts import RobotFacts
from woosh_robot_agent.vda5050.robot.marks import RobotMarks


class OrderIntake:
    """Reads and checks orders.

    Args:
        version: version of the standard.
        registry: the actions of the vehicle.
        facts: what the robot reports.
        marks: the marks of the robot.
    """

    def __init__(
        self, version: Version, registry: Registry, facts: RobotFacts, marks: RobotMarks
    ) -> None:
        self._version = version
        self._registry = registry
        self._facts = facts
        self._marks = marks

    def read(self, payload: bytes) -> Order:
        """Return a received order, with the marks to which the robot drives.

        Raises:
            RejectedError: the message is malformed.
        """
        order = read_order(payload, self._version)
        status = self._facts.status
        place = status.position if status is not None else None
        return with_marks(order, "" if place is None else place.map_id, self._marks.find)

    def check(self, order: Order) -> None:
        """Check an order against what the vehicle can do now.

        Raises:
            RejectedError: the vehicle cannot perform it.
        """
        OrderCheck(order, self._registry).check(self._facts.status)
