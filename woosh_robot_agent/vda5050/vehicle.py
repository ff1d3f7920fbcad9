"""One robot as a VDA 5050 vehicle: start and end, handling of events, factsheet and state."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import replace
from typing import Any

from woosh_robot_agent.link import LinkError, RobotIdentity
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.tools.dashboard.texts import value_data
from woosh_robot_agent.vda5050.actions.runner import ActionRunner, action_types
from woosh_robot_agent.vda5050.execution import PAUSE, Execution
from woosh_robot_agent.vda5050.intake import Intake
from woosh_robot_agent.vda5050.messages.factsheet import Factsheet
from woosh_robot_agent.vda5050.messages.state import (
    ErrorType,
    VehicleError,
    VehicleState,
    warning,
)
from woosh_robot_agent.vda5050.messages.versions import Identity, Topic
from woosh_robot_agent.vda5050.mqtt import BrokerConfig
from woosh_robot_agent.vda5050.reports import Reports
from woosh_robot_agent.vda5050.robot.link import RobotLink
from woosh_robot_agent.vda5050.robot.status import factsheet, serial_number
from woosh_robot_agent.vda5050.session import Session, VehicleConfig
from woosh_robot_agent.vda5050.store import Record

_LOG = logging.getLogger(__name__)
_CLOSE_TIMEOUT = 1.0
"""Maximum wait for the last messages to the broker, and for the robot, in seconds."""

_DROPPED = Sentence("order {order} was dropped, because it was for {robot}")


class Vehicle:
    """One robot as a VDA 5050 vehicle. Used in one asyncio event loop."""

    def __init__(self, config: VehicleConfig, broker: BrokerConfig) -> None:
        self._config = config
        self._broker = broker
        self._link = RobotLink(config.link, config.timing, self._changed, self._moved, self._save)
        log_folder = None if config.state_folder is None else config.state_folder / "reports"
        types = action_types(config.version, can_log=log_folder is not None)
        self._execution = Execution(self._link, config.version, types)
        self._reported = self._execution.robot
        self._reports = Reports(
            config.version,
            config.limits,
            self._state,
            lambda: self._reported.status,
            self._factsheet,
        )
        self._intake = Intake(self._execution)
        self._runner = ActionRunner(self._execution, self._reports, log_folder)
        self._robot_identity = RobotIdentity(0, 0)
        """Identity of the robot; zeros until its first report."""
        self._session: Session | None = None
        """Connection to the broker; None until the first report of the robot."""
        self._progress: object = None
        """Values for which the order or actions may wait, at the last pose. `_moved` compares them
        with the new ones, and calls `_update` only after a change."""
        self._is_updating = False
        """True during `_update` and `_restore`: `_changed`, `_update` and `_save` do nothing."""
        self._is_update_due = False
        """True if `_changed` has scheduled `_update`."""
        self._link.chassis.on_snapshot(self._identified)

    # Start and end

    def start(self) -> None:
        """Start connecting to the robot, and to the broker once the robot is known."""
        self._link.chassis.start()

    async def close(self) -> None:
        """Close the connections to robot and broker. The robot continues its current task."""
        self._save()
        self._link.is_closing = True  # tasks that end from now on must not change the order
        try:
            await self._link.gate.close(_CLOSE_TIMEOUT)
        except LinkError as error:
            _LOG.error("the robot may be moving, press its emergency stop: %s", error)
        await self._link.background.close()
        if self._session is not None:
            await self._session.close(_CLOSE_TIMEOUT)
        await self._link.chassis.close()  # at the end: no state must say that the link is lost

    def _identified(self, info: RobotInfo) -> None:
        """Connect to the broker after the first report, which tells the identity of the robot.

        After a reconnect, publish the factsheet: the robot may have other firmware.
        """
        if self._link.is_closing:
            return
        if self._session is not None:
            self._reports.publish_factsheet()
            return
        config = self._config
        self._robot_identity = RobotIdentity.of(info)
        identity = Identity(config.manufacturer, config.serial_number or serial_number(info))
        intake = self._intake
        intake.identity = identity
        self._session = Session(
            config,
            self._broker,
            identity,
            self._reports,
            {
                Topic.ORDER: intake.take_order,
                Topic.INSTANT_ACTIONS: intake.take_instant_actions,
                Topic.ZONE_SET: intake.refuse_zone_set,
            },
            intake.take_stops,
            self._restore,
            self._wait_for_marks,
            self._update,
        )
        self._session.start()

    def _restore(self, record: Record, damage: VehicleError | None) -> None:
        """Restore the order and the actions after a restart.

        If another robot answers than before the restart, drop them, and report the loss of an
        unfinished order.

        Args:
            record: content of the state file; empty after a first start.
            damage: error of a damaged file; None if the file was not damaged.
        """
        execution, info = self._execution, self._reported.info
        assert info is not None  # the session begins after the first report
        if damage is not None:
            execution.report_order_error(damage)
        former = RobotIdentity(record.robot_id, record.serial_number)
        if former.differs_from(self._robot_identity):
            if record.order.is_unfinished:
                reason = _DROPPED(order=record.order.order_id, robot=str(former))
                _LOG.error("%s; now %s answers", reason, self._robot_identity)
                execution.report_order_error(
                    warning(ErrorType.INTERRUPTED, reason, "send a new order")
                )
            return
        self._is_updating = True  # nothing is saved or sent before everything is restored
        execution.speed.restore(record.speed_is_limited)
        execution.calls.restore(record.calls)
        execution.tasks.restore(record.action_task_id, info, lambda: self._reported.is_charging)
        execution.set_pause_wanted(PAUSE in record.order.holds)
        execution.order.restore(record.order)
        execution.instant.restore(record.instant_actions, record.known_ids)
        if execution.order.driving:
            execution.drive.restore(record.task_id, info)
        self._is_updating = False
        if execution.order.busy:
            _LOG.info("order %s goes on after a restart", record.order.order_id)
        self._update()

    async def _wait_for_marks(self) -> None:
        """Wait for the marks, unless there is something that the master control may want to stop.

        An order that came before the marks would drive by poses instead of docking at them.
        """
        execution = self._execution
        if not (execution.order.busy or execution.is_executing):
            await execution.maps.wait_for_marks()

    def _save(self) -> None:
        """Save the state that must survive a restart."""
        execution = self._execution
        if self._session is not None and not self._is_updating:
            self._session.save(
                Record(
                    robot_id=self._robot_identity.robot_id,
                    serial_number=self._robot_identity.serial_number,
                    task_id=execution.drive.id,
                    action_task_id=execution.tasks.awaited_id,
                    calls=execution.calls.commands,
                    order=execution.order.memory,
                    instant_actions=execution.instant.states,
                    known_ids=execution.instant.known_ids,
                    last_motion=execution.instant.last_motion,
                    speed_is_limited=execution.speed.is_limited,
                )
            )

    def summary(self) -> dict[str, Any] | None:
        """Return the order and the errors for the dashboard; None before the first report."""
        state = self._state()
        if state is None:
            return None
        order = state.order
        return {
            "id": order.order_id,
            "node": order.last_node_id,
            "nodesLeft": len(order.nodes),
            "paused": state.paused,
            "errors": [
                {"type": each.type, "level": each.level.name, "text": value_data(each.description)}
                for each in state.errors
            ],
        }

    # Events

    def _moved(self) -> None:
        """Handle a new pose of the robot, which comes several times per second."""
        order, robot = self._execution.order, self._reported
        self._execution.update_position()
        map_id = None if robot.position is None else robot.position.map_id
        # actions may wait for the standstill, and the order for the map
        progress = (order.progress, robot.is_driving, map_id)
        if progress != self._progress:
            self._progress = progress
            self._update()
        self._execution.speed.limit(order.speed_limit)
        self._link.conditions.check()
        self._reports.moved()

    def _changed(self) -> None:
        """Schedule `_update`, once for all events that are handled before it is called."""
        if not (self._is_update_due or self._is_updating):
            self._is_update_due = True
            asyncio.get_running_loop().call_soon(self._update)

    def _update(self) -> None:
        """Execute the commands that follow from the events so far, and publish the state soon.

        Called after each event, but after a new pose only if `_moved` finds it necessary.
        """
        self._is_update_due = False
        session, execution = self._session, self._execution
        if session is None or not session.is_open:
            return
        if self._is_updating or self._link.is_closing:
            return
        self._is_updating = True
        try:
            execution.is_only_connector = not session.has_other_connector
            execution.update_position()
            execution.clear_forbidden_order()
            execution.execute_commands(self._runner.execute)
            self._runner.poll()
        finally:
            self._is_updating = False
        self._save()  # before the commands are sent: the asyncio tasks that send them run later
        self._link.conditions.check()
        self._reports.changed()

    # To the master control

    def _factsheet(self) -> Factsheet | None:
        """Return the factsheet; None before the first report of the robot."""
        info = self._reported.info
        if info is None:
            return None
        return factsheet(info, self._config.limits, tuple(self._execution.types.values()))

    def _state(self) -> VehicleState | None:
        """Return the complete state; None before the first report of the robot."""
        robot, execution = self._execution.robot_status, self._execution
        if robot is None:
            return None
        if not self._link.ready:
            robot = replace(robot, velocity=None)  # the last one may not hold any more
        if not execution.order.driving:
            robot = replace(robot, path=())  # of a task that is not of the order
        errors = (
            *execution.order_errors,
            self._intake.message_error,
            *execution.order.errors,
            *execution.instant.errors,
            *(() if self._session is None else self._session.errors),
            *execution.errors(),
            *robot.errors,
        )
        return VehicleState(
            execution.order.status,
            robot,
            execution.instant.states,
            execution.paused,
            tuple(error for error in errors if error is not None),
        )
