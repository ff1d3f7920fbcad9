"""Acceptance of messages of the master control."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from woosh_robot_agent.link.log_once import LogOnce, one_line
from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.model.errors import RejectedError, VehicleError
from woosh_robot_agent.vda5050.model.order import Action, Order
from woosh_robot_agent.vda5050.order_check import OrderCheck
from woosh_robot_agent.vda5050.orders.acceptance import Verdict
from woosh_robot_agent.vda5050.orders.machine import OrderMachine
from woosh_robot_agent.vda5050.orders.mark_nodes import with_marks
from woosh_robot_agent.vda5050.orders.structure import check_instant_ids
from woosh_robot_agent.vda5050.parsing import read_instant_actions, read_order, refusal_of_zone_set
from woosh_robot_agent.vda5050.protocol.base import Version
from woosh_robot_agent.vda5050.protocol.header import Identity
from woosh_robot_agent.vda5050.robot.facts import RobotFacts
from woosh_robot_agent.vda5050.robot.maps import MapLibrary
from woosh_robot_agent.vda5050.robot.marks import RobotMarks

_LOG = logging.getLogger(__name__)


class _Accepted(NamedTuple):
    """An order that was accepted.

    Attributes:
        payload: the message.
        order: the order in it, without the marks of the robot, which may change.
        machine: got the order.
    """

    payload: bytes
    order: Order
    machine: OrderMachine


class Intake:
    """Accepts or rejects the messages of the master control, and keeps the reasons of rejections.

    Args:
        version: version of the standard.
        registry: the actions of the vehicle.
        facts: what the robot reports.
        marks: the marks of the robot.
        maps: the maps of the robot.
        taken_ids: returns the ids of instant actions, which no action of an order may have; called
            with True for a new order, and with False for an update.

    Attributes:
        order_error: why the last order was rejected or dropped; None if one was accepted since.
        message_error: why the last message with instant actions or zones was rejected; None if it
            was not.
    """

    def __init__(
        self,
        version: Version,
        registry: Registry,
        facts: RobotFacts,
        marks: RobotMarks,
        maps: MapLibrary,
        taken_ids: Callable[[bool], Collection[str]],
    ) -> None:
        self._version = version
        self._registry = registry
        self._facts = facts
        self._marks = marks
        self._maps = maps
        self._taken_ids = taken_ids
        self._log = LogOnce(_LOG)
        self._accepted: _Accepted | None = None
        """The last order that was accepted; None if there was none."""
        self.order_error: VehicleError | None = None
        self.message_error: VehicleError | None = None

    def order(self, payload: bytes, identity: Identity, machine: OrderMachine) -> Verdict | None:
        """Accept or reject an order.

        Args:
            payload: the message.
            identity: identity of the vehicle.
            machine: gets the order.

        Returns:
            The verdict; None if the order was rejected.
        """
        last = self._accepted if self._accepted and self._accepted.machine is machine else None
        if last is not None and payload == last.payload:
            return Verdict.KNOWN  # at no cost: a master control may repeat a large order often
        try:
            received = read_order(payload, self._version, identity)
            if last is not None and received == last.order:
                return Verdict.KNOWN
            order = self._with_marks(received)
            is_new = order.id != machine.status.order_id
            verdict = machine.receive(order, partial(self._check, is_new=is_new))
        except RejectedError as rejected:
            self._log.warn(f"order: {rejected}", f"an order was rejected: {rejected}")
            self.order_error = rejected.error
            return None
        if verdict is not Verdict.KNOWN:
            _LOG.info("order %s, update %d accepted", one_line(order.id), order.update_id)
            self._log.clear()
            self.order_error = None
            self._accepted = _Accepted(payload, received, machine)
        if verdict is Verdict.NEW:
            self.message_error = None
        return verdict

    def instant_actions(self, payload: bytes, identity: Identity) -> list[Action]:
        """Return received instant actions; none if the message is rejected."""
        try:
            actions = read_instant_actions(payload, self._version, identity)
        except RejectedError as rejected:
            self._log.warn(f"actions: {rejected}", f"instant actions were rejected: {rejected}")
            self.message_error = rejected.error
            return []
        self.message_error = None
        return actions

    def refuse_zone_set(self, payload: bytes, identity: Identity) -> None:
        """Refuse a zone set: the robot takes no zones."""
        error = refusal_of_zone_set(payload, self._version, identity)
        reason = error.description
        self._log.warn(f"zones: {reason}", f"a zone set was refused: {reason}")
        self.message_error = error

    def _with_marks(self, order: Order) -> Order:
        """Return an order with the marks by which the robot drives to its nodes."""
        status = self._facts.status
        place = status.position if status is not None else None
        return with_marks(order, "" if place is None else place.map_id, self._marks.find)

    def _check(self, order: Order, *, is_new: bool) -> None:
        """Check an order against what the vehicle can do now.

        Raises:
            RejectedError: the vehicle cannot perform it.
        """
        check_instant_ids(order, self._taken_ids(is_new))
        status, info = self._facts.status, self._facts.info
        if status is not None and info is not None:
            status = replace(status, maps=self._maps.listed(info))
        OrderCheck(order, self._registry).check(status)
