"""One robot as a VDA 5050 vehicle."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from woosh_robot_agent.endpoints import minimum_timeouts
from woosh_robot_agent.link import ChassisClient, LinkConfig, LinkError, LinkState
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.vda5050.actions.instant import InstantActions
from woosh_robot_agent.vda5050.actions.performer import ActionFailedError, Context
from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.actions.runner import ActionRunner
from woosh_robot_agent.vda5050.driving import Driver
from woosh_robot_agent.vda5050.model.errors import (
    ErrorType,
    RejectedError,
    VehicleError,
    warning,
)
from woosh_robot_agent.vda5050.model.factsheet import Scope
from woosh_robot_agent.vda5050.model.order import Order
from woosh_robot_agent.vda5050.model.state import (
    ActionStatus,
    ConnectionState,
    OperatingMode,
    VehicleState,
)
from woosh_robot_agent.vda5050.mqtt import BrokerConfig, MqttConnection
from woosh_robot_agent.vda5050.orders.acceptance import Verdict
from woosh_robot_agent.vda5050.orders.commands import CancelDrive, Drive, EndAction, Perform
from woosh_robot_agent.vda5050.orders.machine import OrderMachine
from woosh_robot_agent.vda5050.protocol.base import Version
from woosh_robot_agent.vda5050.protocol.header import HeaderIds, Identity
from woosh_robot_agent.vda5050.protocol.topics import Topic
from woosh_robot_agent.vda5050.protocol.v2_1 import Version21
from woosh_robot_agent.vda5050.protocol.validation import defect
from woosh_robot_agent.vda5050.publisher import Publisher
from woosh_robot_agent.vda5050.robot.facts import RobotFacts
from woosh_robot_agent.vda5050.robot.factsheet import Limits, factsheet
from woosh_robot_agent.vda5050.schedule import Schedule

_LOG = logging.getLogger(__name__)
_CLOSE_TIMEOUT = 1.0
"""Maximum wait for the last messages to the broker, and for the robot, in seconds."""


@dataclass(frozen=True)
class VehicleConfig:
    """Configuration of a vehicle.

    Attributes:
        link: address of the robot.
        manufacturer: manufacturer in the topics.
        serial_number: serial number in the topics; empty for that of the robot.
        interface: first level of the topics.
        version: version of the standard.
        limits: what the robot does not report about itself.
    """

    link: LinkConfig
    manufacturer: str = "Woosh"
    serial_number: str = ""
    interface: str = "uagv"
    version: Version = field(default_factory=Version21)
    limits: Limits = field(default_factory=Limits)


class Vehicle:
    """One robot as a VDA 5050 vehicle. Used in one asyncio event loop.

    Args:
        config: configuration of the vehicle.
        broker: address of the broker.
    """

    def __init__(self, config: VehicleConfig, broker: BrokerConfig) -> None:
        self._config = config
        self._broker = broker
        self._chassis = ChassisClient(config=config.link, minimum_timeouts=minimum_timeouts())
        self._gate = MotionGate(self._chassis)
        requests = RequestMaker(config.link.robot_id)
        self._facts = RobotFacts(self._chassis, self._moved, self._robot_changed)
        self._machine = OrderMachine()
        self._driver = Driver(
            self._chassis, self._gate, requests, self._drive_ended, self._robot_changed
        )
        context = Context(self._chassis, self._gate, requests, self._facts, self)
        self._registry = Registry(context)
        self._runner = ActionRunner(self._registry, self._action_changed)
        self._instant = InstantActions(self._registry, self._runner)
        self._rejection: VehicleError | None = None
        """Why the last order or message was rejected; None if an order was accepted since."""
        self._cancelled: asyncio.Future[None] | None = None
        """Done when the order has been cancelled; None if it is not being cancelled."""
        self._publisher: Publisher | None = None
        """None until the serial number is known."""
        self._mqtt: MqttConnection | None = None
        limits = config.limits
        self._state_schedule = Schedule(
            self._publish_state, limits.min_state_interval, limits.state_interval
        )
        self._position_schedule = Schedule(self._publish_position, limits.visualization_interval)
        self._tasks: list[asyncio.Task[None]] = []
        self._chassis.on_snapshot(self._identified)

    # Life

    def start(self) -> None:
        """Start connecting to the robot, and to the broker once the robot is known."""
        self._chassis.start()

    async def close(self) -> None:
        """Close both connections. The robot goes on with the task that it executes."""
        try:
            await self._gate.close(_CLOSE_TIMEOUT)
        except LinkError as error:
            _LOG.error("the robot may be moving, press its emergency stop: %s", error)
        self._state_schedule.stop()
        self._position_schedule.stop()
        await self._driver.close()
        await self._runner.close()
        if self._publisher and self._mqtt:
            self._publish_connection(ConnectionState.OFFLINE)
            await self._mqtt.flush(_CLOSE_TIMEOUT)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._chassis.close()

    def _identified(self, info: RobotInfo) -> None:
        """Connect to the broker: the robot has told its serial number."""
        if self._publisher is not None:
            return
        config = self._config
        number = config.serial_number or str(info.genral.serial_number or info.robot_id)
        publisher = self._publisher = Publisher(
            config.version, Identity(config.manufacturer, number), config.interface, HeaderIds()
        )
        self._mqtt = MqttConnection(
            self._broker,
            client_id=f"{config.interface}-{config.manufacturer}-{number}",
            last_will=publisher.last_will,
            handlers={
                publisher.topic(Topic.ORDER): self._order_received,
                publisher.topic(Topic.INSTANT_ACTIONS): self._instant_actions_received,
            },
            on_connected=self._broker_connected,
        )
        run = self._mqtt.run()
        self._tasks.append(asyncio.get_running_loop().create_task(run, name="vda5050 mqtt"))

    def _broker_connected(self) -> None:
        self._publish_connection(ConnectionState.ONLINE)
        self.publish_factsheet()
        self._publish_state()
        self._state_schedule.changed()

    # From the master control

    def _order_received(self, payload: bytes) -> None:
        version = self._config.version
        try:
            order = version.order(_parse(payload, version, Topic.ORDER))
            if self._machine.receive(order, self._check_order) is Verdict.KNOWN:
                return
        except RejectedError as rejected:
            _LOG.warning("an order was rejected: %s", rejected)
            self._rejection = rejected.error
        else:
            _LOG.info("order %s, update %d accepted", order.id, order.update_id)
            self._rejection = None
            if order.update_id == 0:
                self._instant.forget_ended()
        self._step()

    def _check_order(self, order: Order) -> None:
        """Check that the vehicle can perform an order.

        Raises:
            RejectedError: it cannot.
        """
        references = {"orderId": order.id, "orderUpdateId": order.update_id}
        status = self._facts.status
        if status is None or status.mode is not OperatingMode.AUTOMATIC:
            raise RejectedError(
                warning(
                    ErrorType.ORDER,
                    "the robot is not in automatic mode",
                    "switch the robot to automatic control and task mode",
                    **references,
                )
            )
        for parts, scope in ((order.nodes, Scope.NODE), (order.edges, Scope.EDGE)):
            for part in parts:
                for action in part.actions:
                    if objection := self._registry.objection(action, scope):
                        raise RejectedError(
                            warning(
                                ErrorType.ORDER,
                                objection,
                                "see the factsheet for the actions of the vehicle",
                                **references,
                                actionId=action.id,
                                actionType=action.type,
                            )
                        )

    def _instant_actions_received(self, payload: bytes) -> None:
        version = self._config.version
        try:
            actions = version.instant_actions(_parse(payload, version, Topic.INSTANT_ACTIONS))
        except RejectedError as rejected:
            _LOG.warning("instant actions were rejected: %s", rejected)
            self._rejection = rejected.error
        else:
            self._instant.receive(actions)
        self._step()

    # From the robot

    def _moved(self) -> None:
        status = self._facts.status
        if status is not None and status.position is not None:
            before = self._machine.status.last_node_sequence_id
            self._machine.moved(status.position)
            if self._machine.status.last_node_sequence_id != before:
                self._step()
        self._position_schedule.changed()

    def _robot_changed(self) -> None:
        status = self._facts.status
        if status is not None and status.position is not None:
            self._machine.moved(status.position)
        self._step()

    def _drive_ended(self, reason: str) -> None:
        self._machine.drive_ended(reason)
        self._step()

    def _action_changed(self, action_id: str, status: ActionStatus, result: str) -> None:
        if not self._instant.changed(action_id, status, result):
            self._machine.action_changed(action_id, status, result)
        self._step()

    # Execution

    def _step(self) -> None:
        """Execute what follows from the events so far, and publish the state soon."""
        status = self._facts.status
        may_drive = (
            status is not None
            and status.mode is OperatingMode.AUTOMATIC
            and self._chassis.state is LinkState.READY
        )
        for command in self._machine.poll(may_drive=may_drive):
            if isinstance(command, Drive):
                self._driver.start(command.leg, status.position if status else None)
            elif isinstance(command, CancelDrive):
                self._driver.cancel()
            elif isinstance(command, Perform):
                self._runner.start(command.action)
            elif isinstance(command, EndAction):
                self._runner.end(command.action)
        if self._cancelled is not None and not self._machine.canceling:
            self._cancelled.set_result(None)
            self._cancelled = None
        self._state_schedule.changed()

    # Controls for actions

    async def cancel_order(self, action_id: str) -> None:
        if not self._machine.busy:
            self._instant.errors.append(
                warning(
                    ErrorType.NO_ORDER_TO_CANCEL, "there is no order to cancel", actionId=action_id
                )
            )
            raise ActionFailedError("there is no order to cancel")
        if self._cancelled is None:
            self._cancelled = asyncio.get_running_loop().create_future()
            self._machine.cancel()
        cancelled = self._cancelled
        self._step()
        await asyncio.shield(cancelled)

    def publish_state(self) -> None:
        self._state_schedule.changed()

    def publish_factsheet(self) -> None:
        info = self._facts.info
        if info is not None:
            sheet = factsheet(info, self._config.limits, self._registry.types)
            self._publish(Topic.FACTSHEET, lambda: self._config.version.factsheet(sheet))

    # To the master control

    def _publish_state(self) -> None:
        robot = self._facts.status
        if robot is None:
            return
        order = self._machine.status
        order = replace(
            order, actions=order.actions + self._instant.states, paused=self._driver.paused
        )
        errors = (self._rejection, self._machine.error, *self._instant.errors, *robot.errors)
        state = VehicleState(order, robot, tuple(error for error in errors if error is not None))
        self._publish(Topic.STATE, lambda: self._config.version.state(state))

    def _publish_position(self) -> None:
        status = self._facts.status
        if status is not None:
            self._publish(
                Topic.VISUALIZATION,
                lambda: self._config.version.visualization(status.position, status.velocity),
            )

    def _publish_connection(self, state: ConnectionState) -> None:
        self._publish(Topic.CONNECTION, lambda: self._config.version.connection(state))

    def _publish(self, topic: Topic, content: Callable[[], dict[str, Any]]) -> None:
        if self._publisher is not None and self._mqtt is not None and self._mqtt.connected:
            self._publisher.publish(self._mqtt, topic, content())


def _parse(payload: bytes, version: Version, topic: Topic) -> dict[str, Any]:
    """Return a message of the master control.

    Raises:
        RejectedError: it is malformed.
    """
    try:
        message = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise RejectedError(
            warning(
                ErrorType.VALIDATION,
                f"the message on {topic.value} is no JSON: {error}",
                "correct the message and send it again",
                topic=topic.value,
            )
        ) from None
    found = defect(version.number, topic.value, message)
    if found is None:
        return message  # type: ignore[no-any-return]
    field_path, reason = found
    references = {
        key: message[key]
        for key in ("headerId", "orderId", "orderUpdateId")
        if isinstance(message, dict) and key in message
    }
    raise RejectedError(
        warning(
            ErrorType.VALIDATION,
            f"the message on {topic.value} is malformed at {field_path or 'its top'}: {reason}",
            "correct the message and send it again",
            topic=topic.value,
            **references,
        )
    )
