"""One robot as a VDA 5050 vehicle."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.endpoints import minimum_timeouts
from woosh_robot_agent.link import ChassisClient, LinkError, LinkState, RobotIdentity
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.vda5050.actions.instant import InstantActions
from woosh_robot_agent.vda5050.actions.performer import Context, RobotTasks
from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.actions.robot_calls import (
    ActionFailedError,
    Conditions,
    Pause,
    RobotCalls,
)
from woosh_robot_agent.vda5050.actions.runner import ActionRunner
from woosh_robot_agent.vda5050.actions.standard import CancelOrder, LogReport
from woosh_robot_agent.vda5050.drive_permission import DrivePermission
from woosh_robot_agent.vda5050.driving import Driver
from woosh_robot_agent.vda5050.intake import Intake
from woosh_robot_agent.vda5050.messages.factsheet import Factsheet
from woosh_robot_agent.vda5050.messages.order import Action
from woosh_robot_agent.vda5050.messages.protocol import Identity, Topic
from woosh_robot_agent.vda5050.messages.state import (
    ActionStatus,
    ErrorType,
    OperatingMode,
    OrderStatus,
    Position,
    VehicleError,
    VehicleState,
    warning,
)
from woosh_robot_agent.vda5050.mqtt import BrokerConfig
from woosh_robot_agent.vda5050.orders.legs import (
    CancelDrive,
    Drive,
    EndAction,
    PauseDrive,
    Perform,
    ResumeDrive,
    stops,
)
from woosh_robot_agent.vda5050.orders.machine import OrderMachine
from woosh_robot_agent.vda5050.orders.structure import Verdict
from woosh_robot_agent.vda5050.reports import Reports
from woosh_robot_agent.vda5050.robot.facts import RobotFacts
from woosh_robot_agent.vda5050.robot.maps import MapLibrary, RobotMarks
from woosh_robot_agent.vda5050.robot.status import factsheet
from woosh_robot_agent.vda5050.session import Session, SessionConfig
from woosh_robot_agent.vda5050.speed import SpeedLimiter
from woosh_robot_agent.vda5050.store import Record
from woosh_robot_agent.vda5050.vehicle_config import VehicleConfig

_LOG = logging.getLogger(__name__)
_PAUSE = "pause"
"""Name of the hold by which a pause stops the drive."""
_CLOSE_TIMEOUT = 1.0
"""Maximum wait for the last messages to the broker, and for the robot, in seconds."""


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
        self._facts = RobotFacts(self._chassis, requests, self._moved, self._robot_changed)
        self._machine = OrderMachine()
        self._driver = Driver(
            self._chassis,
            self._gate,
            requests,
            self._drive_ended,
            self._drive_unsent,
            self._robot_changed,
        )
        self._speed = SpeedLimiter(
            self._chassis,
            self._gate,
            requests,
            self._remember,
            self._speed_refused,
        )
        self._refused_speed = ""
        """Reason of a refused speed limit while the drive is cancelled for it; otherwise empty."""
        self._marks = RobotMarks(self._chassis, self._robot_changed)
        self._maps = MapLibrary(self._chassis, self._robot_changed)
        self._waits = Conditions()
        self._pause = Pause()
        self._pause.join(
            self._apply_pause, lambda: not self._machine.driving or self._driver.stands
        )
        work = (self._chassis, self._gate, requests, self._pause, self._waits)
        self._calls = RobotCalls(*work)
        self._robot_tasks = RobotTasks(*work)
        context = Context(
            chassis=self._chassis,
            gate=self._gate,
            requests=requests,
            facts=self._facts,
            maps=self._maps,
            marks=self._marks,
            pause=self._pause,
            conditions=self._waits,
            calls=self._calls,
            tasks=self._robot_tasks,
            vehicle=self,
        )
        further = (
            (partial(LogReport, folder=config.log_folder),) if config.log_folder is not None else ()
        )
        self._permission = DrivePermission(
            self._chassis, self._gate, self._facts, self._driver, self._robot_tasks, self._calls
        )
        forgets = not config.version.keeps_instant_actions
        self._registry = Registry(context, config.version.number, further)
        self._intake = Intake(
            config.version,
            self._registry,
            self._facts,
            self._marks,
            self._maps,
            lambda new_order: self._instant.ids_in_state(ended=not (new_order and forgets)),
        )
        self._runner = ActionRunner(
            self._registry, self._pause, self._may_act, self._is_driving, self
        )
        self._instant = InstantActions(self._registry, self._runner, self)
        self._is_cut = False
        """True from a loss of the link until all actions that ran then have ended."""
        self._was_driving = False
        """True if the robot drove at its last report of a pose."""
        self._session: Session | None = None
        """None until the robot has told who it is."""
        self._is_closing = False
        self._is_restoring = False
        """True while the state is restored only in part: it must be neither executed nor saved."""
        self._reports = Reports(
            config.limits, self._state, lambda: self._facts.status, self._factsheet
        )
        self._chassis.on_snapshot(self._identified)
        self._chassis.on_state(self._link_changed)

    # Life

    def start(self) -> None:
        """Start connecting to the robot, and to the broker once the robot is known."""
        self._chassis.start()

    async def close(self) -> None:
        """Close both connections. The robot goes on with the task that it executes."""
        self._remember()
        self._is_closing = True  # tasks that end from now on must not change the order
        try:
            await self._gate.close(_CLOSE_TIMEOUT)
        except LinkError as error:
            _LOG.error("the robot may be moving, press its emergency stop: %s", error)
        await self._driver.close()
        await self._speed.close()
        await self._marks.close()
        await self._calls.close()
        await self._robot_tasks.close()
        await self._runner.close()
        await self._maps.close()
        await self._facts.close()
        if self._session is not None:
            await self._session.close(_CLOSE_TIMEOUT)
        await self._chassis.close()

    def _identified(self, info: RobotInfo) -> None:
        """Connect to the broker when the robot has told who it is."""
        if self._is_closing:
            return
        if self._session is not None:
            self._machine.doubt_place()  # the robot may have been moved while there was no link
            self._robot_changed()
            return
        config = self._config
        number = config.serial_number or str(info.genral.serial_number or info.robot_id)
        session = SessionConfig(
            broker=self._broker,
            version=config.version,
            identity=Identity(config.manufacturer, number),
            interface=config.interface,
            state_folder=config.state_folder,
        )
        self._session = Session(
            session,
            RobotIdentity.of(info),
            self._reports,
            {
                Topic.ORDER: self._order_received,
                Topic.INSTANT_ACTIONS: self._instant_actions_received,
                Topic.ZONE_SET: self._zone_set_received,
            },
            self._restore,
            self._step,
        )
        self._session.start()

    def _restore(self, record: Record, damage: VehicleError | None) -> None:
        """Restore the order after a restart, and ask the robot for the state of its task."""
        info, session = self._facts.info, self._session
        if info is None or session is None:
            return
        self._intake.order_error = damage
        former = RobotIdentity(record.robot_id, record.serial_number)
        if former.differs_from(session.robot):
            reason = f"order {record.order.order_id} was dropped, because it was for {former}"
            _LOG.error("%s; now %s answers", reason, session.robot)
            self._intake.order_error = warning(ErrorType.INTERRUPTED, reason, "send a new order")
            return
        self._is_restoring = True
        self._speed.restore(record.speed_is_limited)
        self._machine.restore(record.order)
        self._pause.set(_PAUSE in record.order.holds)
        for action_id in self._instant.restore(
            record.instant_actions,
            record.known_ids,
            record.order.holds,
            again=CancelOrder.type.name,
        ):
            self._machine.interrupt(action_id)
        if self._machine.driving:
            self._driver.restore(record.task_id, info)
        self._is_restoring = False
        if self._machine.busy:
            _LOG.info("order %s goes on after a restart", record.order.order_id)
        self._robot_changed()

    def _remember(self) -> None:
        """Save the state that must survive a restart."""
        session = self._session
        if session is not None and not self._is_restoring:
            session.save(
                Record(
                    robot_id=session.robot.robot_id,
                    serial_number=session.robot.serial_number,
                    task_id=self._driver.task_id,
                    order=self._machine.memory,
                    instant_actions=self._instant.states,
                    known_ids=self._instant.known_ids,
                    last_motion=self._instant.last_motion,
                    speed_is_limited=self._speed.is_limited,
                )
            )

    def _clear_order(self, cause: str, hint: str) -> None:
        """Clear the order, as the standard demands in modes other than AUTOMATIC."""
        if not self._machine.busy or self._machine.canceling:
            return
        order = self._machine.status.order_id
        reason = f"order {order} was cleared, because {cause}"
        _LOG.warning("%s", reason)
        self._intake.order_error = warning(ErrorType.INTERRUPTED, reason, hint, orderId=order)
        self._machine.cancel(reason)

    # From the master control

    def _order_received(self, payload: bytes) -> None:
        if self._session is None:
            return
        verdict = self._intake.order(payload, self._session.identity, self._machine)
        if verdict is Verdict.NEW:
            if self._config.version.keeps_instant_actions:
                self._instant.errors.clear()
            else:
                self._instant.forget_ended()
        if verdict is not Verdict.KNOWN:
            self._step()

    def _instant_actions_received(self, payload: bytes) -> None:
        if self._session is not None:
            self._instant.receive(self._intake.instant_actions(payload, self._session.identity))
            self._step()

    def _zone_set_received(self, payload: bytes) -> None:
        if self._session is not None:
            self._intake.refuse_zone_set(payload, self._session.identity)
            self._step()

    # From the robot

    def _link_changed(self, state: LinkState) -> None:
        if state is not LinkState.READY:
            self._machine.lose_track()
            self._is_cut = True
        self._step()

    def _moved(self) -> None:
        status = self._facts.status
        if status is not None and status.position is not None:
            before = self._machine.status
            self._follow(status.position)
            after = self._machine.status
            if _progress(before) != _progress(after):
                self._step()
            self._speed.limit(self._machine.speed_limit)
        if status is not None and status.driving != self._was_driving:
            self._was_driving = status.driving
            self._step()  # actions may wait for the standstill
        self._waits.check()
        self._reports.moved()

    def _follow(self, position: Position) -> None:
        """Take a new position of the robot."""
        self._is_cut = self._is_cut and self._runner.busy
        # after a loss of the link, the robot may have been moved while any other action ran
        is_acting = self._calls.moves_base if self._is_cut else self._runner.busy
        is_acting = is_acting or self._robot_tasks.task_id != 0
        self._machine.moved(position, by_itself=is_acting, confirmed=self._driver.confirmed)
        status = self._facts.status
        if status is not None and status.mode is OperatingMode.MANUAL:
            self._machine.forget_left_node()

    def _robot_changed(self) -> None:
        status = self._facts.status
        if status is not None and status.position is not None:
            self._follow(status.position)
        if status is not None and status.mode is not OperatingMode.AUTOMATIC:
            self._clear_order(
                f"the operating mode is {status.mode.value}", "send a new order in mode AUTOMATIC"
            )
            if status.mode is not OperatingMode.MANUAL and not self._machine.busy:
                self._machine.placed("")
        elif self._has_lost_position():
            self._clear_order(
                "the robot does not know its position any more",
                "initialise it, and send a new order",
            )
        self._step()

    def _has_lost_position(self) -> bool:
        """Return True if an order must be cleared, because the position is unknown."""
        status = self._facts.status
        if status is None or status.position is None or status.position.initialised:
            return False
        is_told = self._machine.acting or self._runner.busy  # an action may set the position
        return self._config.version.clears_lost_orders and not is_told

    def _speed_refused(self, reason: str) -> None:
        _LOG.error("the drive is cancelled: %s", reason)
        self._refused_speed = reason
        self._driver.cancel()

    def _drive_ended(self, reason: str) -> None:
        self._machine.drive_ended(self._refused_speed or reason)
        self._refused_speed = ""
        self._step()

    def _drive_unsent(self) -> None:
        self._machine.drive_unsent()
        self._step()

    # Execution

    def _step(self) -> None:
        """Execute what follows from the events so far, and publish the state soon."""
        if self._session is None or not self._session.is_open:
            return
        if self._is_closing or self._is_restoring:
            return
        status = self._facts.status
        if self._permission.is_driven_otherwise(self._machine):
            self._machine.doubt_place()
        may_drive = (
            self._permission.may_drive(self._machine) and not self._session.has_other_connector
        )
        # cancelOrder empties the order itself, so that both are in the same state
        may_empty = self.at_rest and not self._instant.runs(CancelOrder.type.name)
        for command in self._machine.poll(may_drive=may_drive, may_empty=may_empty):
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
        self._speed.limit(self._machine.speed_limit)
        self._runner.poll()
        self._remember()  # before the commands are sent: nothing has been awaited since
        self._waits.check()
        self._reports.changed()

    # Controls for actions

    @property
    def has_leg(self) -> bool:
        return self._machine.driving

    @property
    def paused(self) -> bool:
        if self._pause.wanted:
            return self._pause.in_effect
        return self._driver.paused and not self._machine.held

    @property
    def at_rest(self) -> bool:
        status = self._facts.status
        if status is None or not status.driving or status.mode is not OperatingMode.AUTOMATIC:
            return True
        return self._permission.is_driven_otherwise(self._machine)

    def order_has_action(self, action_id: str) -> bool:
        return any(each.id == action_id for each in self._machine.status.actions)

    def hold(self, name: str) -> None:
        self._machine.hold(name)
        self._step()

    def release(self, name: str) -> None:
        self._machine.release(name)
        self._step()

    def resume(self) -> None:
        self._driver.resume()

    def set_last_node(self, node_id: str) -> None:
        self._machine.placed(node_id)

    def clear_instant_actions(self) -> None:
        self._instant.forget_ended()

    def action_changed(self, action_id: str, status: ActionStatus, result: str) -> None:
        if not self._instant.changed(action_id, status, result):
            self._machine.action_changed(action_id, status, result)
        self._step()

    def action_failed(self, action: Action, reason: str, kind: ErrorType) -> None:
        if kind is ErrorType.INTERRUPTED:
            kind = ErrorType.ACTION  # the order is interrupted; the action has failed
            if stops((action,)):
                self._machine.interrupt(action.id, reason)
        self._instant.failed(action, reason, kind)

    def _apply_pause(self, pause: bool) -> None:
        if pause:
            self.hold(_PAUSE)
        else:
            self.release(_PAUSE)

    def _may_act(self) -> bool:
        """Return True if actions of the robot may begin."""
        session = self._session
        is_alone = session is not None and not session.has_other_connector
        return is_alone and self._chassis.state is LinkState.READY

    def _is_driving(self) -> bool:
        """Return True while the robot drives along the order, or still moves."""
        return (self._machine.driving and not self._driver.stands) or not self.at_rest

    async def cancel_order(self, order_id: str) -> None:
        machine = self._machine
        if not (machine.busy or machine.canceling):
            raise ActionFailedError("there is no order to cancel", ErrorType.NO_ORDER_TO_CANCEL)
        current = machine.status.order_id
        if order_id not in ("", current):
            raise ActionFailedError(
                f"the vehicle executes order {current}, not {order_id}",
                ErrorType.NO_ORDER_TO_CANCEL,
            )
        if not machine.canceling:
            machine.cancel()
        self._step()
        await self._waits.wait(
            lambda: not machine.canceling or (machine.has_ended and self.at_rest)
        )
        if machine.canceling:
            machine.empty()

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
        order = replace(order, actions=order.actions + self._instant.states, paused=self.paused)
        if self._facts.info is not None:
            robot = replace(robot, maps=self._maps.listed(self._facts.info))
        if self._chassis.state is not LinkState.READY:
            robot = replace(robot, velocity=None)
        errors = (
            self._intake.order_error,
            self._intake.message_error,
            *self._machine.errors,
            *self._instant.errors,
            *(() if self._session is None else self._session.errors),
            *self._permission.errors(self._machine),
            *robot.errors,
        )
        return VehicleState(order, robot, tuple(error for error in errors if error is not None))


def _progress(order: OrderStatus) -> tuple[object, ...]:
    """Return what is published at once when the robot has moved."""
    return order.last_node_id, order.last_node_sequence_id, order.new_base_request
