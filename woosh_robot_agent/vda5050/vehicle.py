"""One robot as a VDA 5050 vehicle."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass, field, replace

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
from woosh_robot_agent.vda5050.inbox import read_instant_actions, refusal_of_zone_set
from woosh_robot_agent.vda5050.model.errors import (
    ErrorType,
    RejectedError,
    VehicleError,
    warning,
)
from woosh_robot_agent.vda5050.model.factsheet import Factsheet
from woosh_robot_agent.vda5050.model.state import (
    ActionStatus,
    OperatingMode,
    RobotStatus,
    VehicleState,
)
from woosh_robot_agent.vda5050.mqtt import BrokerConfig, MqttConnection
from woosh_robot_agent.vda5050.order_intake import OrderIntake
from woosh_robot_agent.vda5050.orders.acceptance import Verdict
from woosh_robot_agent.vda5050.orders.commands import (
    CancelDrive,
    Drive,
    EndAction,
    PauseDrive,
    Perform,
    ResumeDrive,
)
from woosh_robot_agent.vda5050.orders.machine import OrderMachine
from woosh_robot_agent.vda5050.protocol.base import Version
from woosh_robot_agent.vda5050.protocol.header import HeaderIds, Identity
from woosh_robot_agent.vda5050.protocol.topics import Topic
from woosh_robot_agent.vda5050.protocol.v2_1 import Version21
from woosh_robot_agent.vda5050.publisher import Publisher
from woosh_robot_agent.vda5050.reports import Reports
from woosh_robot_agent.vda5050.robot.facts import RobotFacts
from woosh_robot_agent.vda5050.robot.factsheet import Limits, factsheet
from woosh_robot_agent.vda5050.robot.marks import RobotMarks
from woosh_robot_agent.vda5050.speed import SpeedLimiter

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
        self._speed = SpeedLimiter(
            self._chassis, self._gate, requests, config.limits.max_speed, self._speed_refused
        )
        self._refused_speed = ""
        """Why the drive is being cancelled: the robot does not take a speed limit; else empty."""
        self._marks = RobotMarks(self._chassis, self._robot_changed)
        self._was_automatic = False
        context = Context(self._chassis, self._gate, requests, self._facts, self)
        self._registry = Registry(context)
        self._intake = OrderIntake(config.version, self._registry, self._facts, self._marks)
        self._runner = ActionRunner(self._registry, self._action_changed)
        self._instant = InstantActions(self._registry, self._runner)
        self._rejection: VehicleError | None = None
        """Why the last order or message was rejected; None if an order was accepted since."""
        self._cancelled: asyncio.Future[None] | None = None
        """Done when the order has been cancelled; None if it is not being cancelled."""
        self._mqtt: MqttConnection | None = None
        """None until the serial number is known."""
        self._reports = Reports(
            config.limits, self._state, lambda: self._facts.status, self._factsheet
        )
        self._handlers = {
            Topic.ORDER: self._order_received,
            Topic.INSTANT_ACTIONS: self._instant_actions_received,
            Topic.ZONE_SET: self._zone_set_received,
        }
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
        await self._driver.close()
        await self._speed.close()
        await self._marks.close()
        await self._runner.close()
        await self._reports.close(_CLOSE_TIMEOUT)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._chassis.close()

    def _identified(self, info: RobotInfo) -> None:
        """Connect to the broker: the robot has told its serial number."""
        if self._mqtt is not None:
            return
        config = self._config
        number = config.serial_number or str(info.genral.serial_number or info.robot_id)
        publisher = Publisher(
            config.version, Identity(config.manufacturer, number), config.interface, HeaderIds()
        )
        self._mqtt = MqttConnection(
            self._broker,
            client_id=f"{config.interface}-{config.manufacturer}-{number}",
            last_will=publisher.last_will,
            handlers={
                publisher.topic(topic): handler
                for topic, handler in self._handlers.items()
                if topic in config.version.received
            },
            on_connected=self._reports.connected,
        )
        self._reports.use(publisher, self._mqtt)
        run = self._mqtt.run()
        self._tasks.append(asyncio.get_running_loop().create_task(run, name="vda5050 mqtt"))

    # From the master control

    def _order_received(self, payload: bytes) -> None:
        try:
            order = self._intake.read(payload)
            verdict = self._machine.receive(order, self._intake.check)
        except RejectedError as rejected:
            _LOG.warning("an order was rejected: %s", rejected)
            self._rejection = rejected.error
        else:
            if verdict is Verdict.KNOWN:
                return
            _LOG.info("order %s, update %d accepted", order.id, order.update_id)
            self._rejection = None
            if verdict is Verdict.NEW:
                if self._config.version.keeps_instant_actions:
                    self._instant.errors.clear()
                else:
                    self._instant.forget_ended()
        self._step()

    def _instant_actions_received(self, payload: bytes) -> None:
        try:
            actions = read_instant_actions(payload, self._config.version)
        except RejectedError as rejected:
            _LOG.warning("instant actions were rejected: %s", rejected)
            self._rejection = rejected.error
        else:
            self._instant.receive(actions)
        self._step()

    def _zone_set_received(self, payload: bytes) -> None:
        self._rejection = refusal_of_zone_set(payload, self._config.version)
        _LOG.warning("a zone set was refused: %s", self._rejection.description)
        self._step()

    # From the robot

    def _moved(self) -> None:
        status = self._facts.status
        if status is not None and status.position is not None:
            before = self._machine.status
            self._machine.moved(status.position)
            after = self._machine.status
            if (before.last_node_sequence_id, before.new_base_request) != (
                after.last_node_sequence_id,
                after.new_base_request,
            ):
                self._step()
            self._speed.limit(self._machine.speed_limit)
        self._reports.moved()

    def _robot_changed(self) -> None:
        status = self._facts.status
        if status is not None and status.position is not None:
            self._machine.moved(status.position)
        self._check_mode(status)
        self._step()

    def _check_mode(self, status: RobotStatus | None) -> None:
        """Cancel the order if the robot leaves the automatic mode."""
        is_automatic = status is not None and status.mode is OperatingMode.AUTOMATIC
        if self._was_automatic and not is_automatic and self._machine.busy:
            self._machine.cancel("the robot has left the automatic mode")
        self._was_automatic = is_automatic

    def _speed_refused(self, reason: str) -> None:
        _LOG.error("the drive is cancelled: %s", reason)
        self._refused_speed = reason
        self._driver.cancel()

    def _drive_ended(self, reason: str) -> None:
        self._machine.drive_ended(self._refused_speed or reason)
        self._refused_speed = ""
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
            elif isinstance(command, PauseDrive):
                self._driver.pause()
            elif isinstance(command, ResumeDrive):
                self._driver.resume()
            elif isinstance(command, Perform):
                self._runner.start(command.action)
            elif isinstance(command, EndAction):
                self._runner.end(command.action)
        if self._cancelled is not None and not self._machine.canceling:
            self._cancelled.set_result(None)
            self._cancelled = None
        self._speed.limit(self._machine.speed_limit)
        self._reports.changed()

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
        self._reports.changed()

    def publish_factsheet(self) -> None:
        self._reports.publish_factsheet()

    # To the master control

    def _factsheet(self) -> Factsheet | None:
        info = self._facts.info
        if info is None:
            return None
        return factsheet(info, self._config.limits, self._registry.types)

    def _state(self) -> VehicleState | None:
        robot = self._facts.status
        if robot is None:
            return None
        order = self._machine.status
        order = replace(
            order, actions=order.actions + self._instant.states, paused=self._driver.paused
        )
        errors = (self._rejection, *self._machine.errors, *self._instant.errors, *robot.errors)
        return VehicleState(order, robot, tuple(error for error in errors if error is not None))
