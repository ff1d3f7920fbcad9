"""Execute the order and the instant actions of a vehicle with tasks and actions of the robot."""

from __future__ import annotations

import asyncio
import logging
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace

from woosh_robot_agent.link import LinkState
from woosh_robot_agent.motion import SpeedLimiter
from woosh_robot_agent.motion.timeliness import boot_time
from woosh_robot_agent.motion.wheel_owner import WITH_TASK
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.sentences import Sentence, said_by
from woosh_robot_agent.vda5050.messages.factsheet import STANDSTILL, ActionTypes
from woosh_robot_agent.vda5050.messages.order import Action
from woosh_robot_agent.vda5050.messages.state import (
    NO_POSITION,
    ActionStatus,
    ErrorType,
    OperatingMode,
    RobotStatus,
    VehicleError,
    warning,
)
from woosh_robot_agent.vda5050.messages.versions import Version, timestamp
from woosh_robot_agent.vda5050.orders.instant import CANCEL_ORDER, InstantActions
from woosh_robot_agent.vda5050.orders.legs import (
    Command,
    Control,
    Drive,
    EndAction,
    Perform,
    need_standstill,
)
from woosh_robot_agent.vda5050.orders.machine import OrderMachine
from woosh_robot_agent.vda5050.robot.calls import RobotCalls
from woosh_robot_agent.vda5050.robot.link import RobotLink
from woosh_robot_agent.vda5050.robot.maps import RobotMaps
from woosh_robot_agent.vda5050.robot.reported_state import ReportedState
from woosh_robot_agent.vda5050.robot.tasks import (
    UNSENT,
    ActionTasks,
    TaskRunner,
    leg_task,
)

_LOG = logging.getLogger(__name__)
_LINK_LOST = Sentence("the link to the robot is lost; its last state is from {time}")
_BECAUSE = Sentence("{text}: {reason}")
_OBSTACLE = Sentence("an obstacle blocks the way of the robot")
_WAITS = Sentence("the order waits, because {cause}")
_CHARGES = Sentence("the robot executes its charging task")
_MODE = Sentence("the operating mode is {mode}")
_CLEARED = Sentence("order {order} was cleared, because {cause}")
_MAX_ERRORS = 10
"""Maximum number of errors of orders that were not accepted."""
PAUSE = "pause"
"""Name of the hold (reason for which the order must not drive) of a paused vehicle."""
_OTHER_MOTION = (
    Sentence("something else drives the robot")(),
    "wait for its end, or cancel the order",
)
"""Cause and hint if something else drives the robot, but no task in `_OTHER_TASKS`."""
_OTHER_TASKS: dict[int | None, tuple[str, str]] = {
    task.kCharge: (
        Sentence("the robot executes a charging task that this vehicle has not started")(),
        "end it with stopCharging, or wait for its end; switch off automatic charging at the robot "
        "if the master control sends it to chargers",
    ),
    task.kParking: (
        Sentence("the robot executes a parking task that this vehicle has not started")(),
        "wait for its end; switch off automatic parking at the robot if the master "
        "control parks it",
    ),
}
"""Cause and hint if the robot executes a task that this vehicle has not started, by the type of the
task."""


class Execution:
    """Executes the order and the instant actions. Used in the event loop of the link.

    Attributes:
        drive: executes the task that drives the current leg (part of an order without a stop).
        speed: the speed limit of the drive.
        calls: executes the robot's own actions.
        tasks: executes the tasks of actions.
        active: running actions for which other actions may have to wait, by id.
        is_only_connector: False while another connector uses the topics of the vehicle.
        order_errors: why orders were rejected, cleared or lost since the last one was accepted; the
            oldest are forgotten.
        link_lost_at: time at which the link was lost, by `boot_time`; before the first link, the
            time of creation; inf while there is a link.
    """

    def __init__(self, link: RobotLink, version: Version, types: ActionTypes) -> None:
        self.link = link
        self.version = version
        self.types = types
        self.robot = ReportedState(link)
        self.order = OrderMachine()
        self.instant = InstantActions(types, self.order)
        self.drive = TaskRunner(link, self._drive_ended, link.changed)
        self.speed = SpeedLimiter(
            link.chassis, link.gate, link.background.start, self._speed_refused, link.changed
        )
        self.maps = RobotMaps(link)
        self.calls = RobotCalls(link)
        self.tasks = ActionTasks(link)
        self.active: dict[str, Action] = {}
        self.is_only_connector = True
        self.order_errors: deque[VehicleError] = deque(maxlen=_MAX_ERRORS)
        self.link_lost_at = boot_time()
        self._refused_speed = ""
        """Reason of a refused speed limit while the drive is cancelled for it; otherwise empty."""
        self._link_was_lost = False
        """True from a loss of the link until the position is known and no action is active."""
        link.chassis.on_state(self._link_changed)

    # State of the robot: motion, pause and errors

    @property
    def robot_status(self) -> RobotStatus | None:
        """State of the robot, with its maps; None before its first report."""
        status, info = self.robot.status, self.robot.info
        if status is None or info is None:
            return None
        return replace(status, maps=self.maps.listed(info))

    @property
    def has_own_motion(self) -> bool:
        """True while the robot moves in automatic mode, and only the vehicle itself drives it."""
        is_moving = self.robot.is_driving and self.robot.is_automatic
        return is_moving and not self._is_driven_otherwise

    @property
    def is_driving(self) -> bool:
        """True during a drive of the order that is not paused, and while `has_own_motion`."""
        return (
            self.order.driving and not self.drive.controller.stays_paused
        ) or self.has_own_motion

    @property
    def is_executing(self) -> bool:
        """True while the robot executes a drive of the order, or something for an action."""
        return self.order.driving or bool(self.calls.commands or self.tasks.awaited_id)

    @property
    def has_leftovers(self) -> bool:
        """True while the robot executes what an action has started before a restart."""
        return self.calls.has_leftovers or self.tasks.has_leftover

    @property
    def _must_wait(self) -> bool:
        """True if the order must not drive yet, because something else moves the robot, or may.

        That is something outside of the vehicle, or an action that began before a restart.
        """
        may_move_base = self.calls.moves_base or bool(self.tasks.runner.id)
        return self._is_driven_otherwise or (self.has_leftovers and may_move_base)

    @property
    def pause_wanted(self) -> bool:
        """True from a startPause to a stopPause."""
        return PAUSE in self.order.holds

    @property
    def may_act(self) -> bool:
        """True if the link is ready, and no second connector sends commands to the robot."""
        return self.is_only_connector and self.link.ready

    @property
    def paused(self) -> bool:
        """True while the vehicle is paused: a startPause took effect, or people have paused it."""
        if self.pause_wanted:
            is_drive_paused = not self.order.driving or self.drive.controller.stays_paused
            return is_drive_paused and self.calls.all_paused and self.tasks.all_paused
        # a drive that waits for an instant action is held, too, but the vehicle is not paused
        is_drive_paused = self.drive.controller.paused and not self.order.held
        return is_drive_paused or self.calls.any_paused or self.tasks.paused

    @property
    def _is_driven_otherwise(self) -> bool:
        """True if something other than the order and the vehicle's actions drives the robot."""
        if self.order.driving or self.drive.id:  # without a leg: a task that began too late
            return False
        info = self.robot.info
        if info is not None and info.state == robot.kFollowing:  # it follows a person
            return True
        own_id = self.tasks.runner.id
        if foreign_id := self.drive.foreign_id:
            return foreign_id != own_id  # for `drive`, the task of an action is foreign too
        return bool(self.link.gate.wheel_owner.name) and not own_id and not self.calls.moves_base

    @property
    def is_leaving_task(self) -> bool:
        """True from the end of a task until the robot has left it and can take the next one."""
        if self.drive.id or self.tasks.runner.id or self.robot.info is None:
            return False
        is_in_task = self.robot.info.state in WITH_TASK
        now = asyncio.get_running_loop().time()
        return is_in_task and now < max(self.drive.leaves_until, self.tasks.runner.leaves_until)

    @property
    def _may_be_moved_by_action(self) -> bool:
        """True while an action runs that needs a standing robot: such an action may move it."""
        kinds = (self.types.get(each.type) for each in self.active.values())
        return any(kind is not None and kind.blocking == STANDSTILL for kind in kinds)

    @property
    def _has_charging_task(self) -> bool:
        """True while a charging task goes on that no running action of the order has started.

        The task of startCharging usually outlasts the action.
        """
        return bool(self.tasks.runner.id) and not self.order.driving and not self.order.acting

    @property
    def _is_located(self) -> bool:
        """True if the robot knows its position on a map."""
        place = self.robot.position
        return place is not None and place.initialised

    @property
    def _is_acting(self) -> bool:
        """True while an action runs that is of the order, or for which other actions may wait."""
        return self.order.acting or bool(self.active)

    def errors(self) -> Iterator[VehicleError]:
        """Yield the error of a lost link, and errors that tell why the order or robot waits."""
        order = self.order.status
        if not self.link.ready:
            chassis = self.link.chassis
            text = _LINK_LOST(time=timestamp(chassis.since))
            if chassis.last_error is not None:
                text = _BECAUSE(text=text, reason=said_by(chassis.last_error))
            yield warning(
                ErrorType.ROBOT_CONNECTION,
                text,
                "check that the robot is on, and that the network reaches it",
            )
        if self.robot.status is not None and self.robot.status.blocked:
            references: dict[str, str] = {}
            if order.nodes:
                references = {"orderId": order.order_id, "nodeId": order.nodes[0].id}
            yield warning(
                ErrorType.OBSTACLE,
                _OBSTACLE(),
                "clear the way, and the robot drives on; or cancel the order",
                **references,
            )
        if not self.order.can_go_on:  # it waits for an update, or can only be cancelled
            return
        if self._must_wait:
            info = self.robot.info
            is_foreign = self.drive.foreign_id not in (0, self.tasks.runner.id)
            kind = info.task_proc.type if info is not None and is_foreign else None
            cause, hint = _OTHER_TASKS.get(kind, _OTHER_MOTION)
            yield warning(ErrorType.ROBOT_BUSY, _WAITS(cause=cause), hint)
        elif self._has_charging_task:
            yield warning(
                ErrorType.ROBOT_BUSY,
                _WAITS(cause=_CHARGES()),
                "end it with stopCharging, or wait for its end",
            )
        elif self.link.ready and not (self._is_located or self._is_acting):
            yield warning(
                ErrorType.NOT_AVAILABLE,
                _WAITS(cause=NO_POSITION()),
                "place it on the map with initPosition; if an order drives, cancel it first",
            )

    # Events

    def update_position(self) -> None:
        """Give the position of the robot to the order; do nothing while it is unknown.

        In version 3, hold the drive while the position is unknown or the robot is not sure of it.
        In mode MANUAL, also forget the last node once the robot has left it.
        """
        if self.version.is_3 and not self._is_located:
            self.order.position_lost()
            return
        if (place := self.robot.position) is None:
            return
        if not self.active and self.link.ready and place.initialised:
            self._link_was_lost = False
        # after a loss of the link, only an action that surely moves the base explains a new place:
        # otherwise, people may have moved the robot
        by_action = self.calls.moves_base if self._link_was_lost else self._may_be_moved_by_action
        by_task = self.tasks.runner.confirmed  # the robot executes the task of an action
        self.order.moved(place, by_action=by_action or by_task, confirmed=self.drive.confirmed)
        if self.robot.status is not None and self.robot.status.mode is OperatingMode.MANUAL:
            self.order.forget_left_node()

    def clear_forbidden_order(self) -> None:
        """Clear the order if the mode of the robot forbids one.

        Also cancel what was started before a restart, and forget the last node. In mode MANUAL, the
        robot may still stand on that node; `update_position` forgets it once the robot has left it.
        """
        if self.robot.status is None or self.robot.is_automatic:
            return
        mode, order = self.robot.status.mode, self.order
        self.cancel_leftovers()
        if order.busy and not order.canceling:
            reason = _CLEARED(order=order.order_id, cause=_MODE(mode=mode.value))
            _LOG.warning("%s", reason)
            hint = "send a new order in mode AUTOMATIC"
            self.report_order_error(
                warning(ErrorType.INTERRUPTED, reason, hint, orderId=order.order_id)
            )
            order.cancel(reason)
        # a busy order needs its last node until it has ended
        if mode is not OperatingMode.MANUAL and not order.busy:
            order.set_last_node("")

    def set_pause_wanted(self, wanted: bool) -> None:
        """Pause or resume the order and all actions; idempotent."""
        if wanted == self.pause_wanted:
            return
        if wanted:
            self.order.holds.add(PAUSE)
        else:
            self.order.holds.discard(PAUSE)
        control = Control.PAUSE if wanted else Control.RESUME
        self.calls.want(control)
        self.tasks.want(control)
        self.link.changed()

    def cancel_leftovers(self) -> None:
        """Cancel what actions have started before a restart."""
        self.calls.cancel_leftovers()
        self.tasks.cancel_leftover()

    def action_changed(self, action_id: str, status: ActionStatus, result: str = "") -> None:
        """Store the new status of an action of the order or of an instant action."""
        if not self.instant.changed(action_id, status, result):
            self.order.action_changed(action_id, status, result)
        self.link.changed()

    def action_failed(self, action: Action, reason: str, kind: ErrorType) -> None:
        """Report why an action failed. Call it before `action_changed`, which ends the action."""
        if kind is ErrorType.INTERRUPTED:
            kind = ErrorType.ACTION  # the order itself reports that it is interrupted
            if need_standstill((action,)):
                self.order.interrupt(action.id, reason)
        self.instant.failed(action, reason, kind)

    def report_order_error(self, error: VehicleError) -> None:
        """Report why an order was rejected, cleared or lost, unless it is reported already."""
        if error not in self.order_errors:
            self.order_errors.append(error)

    def cancel_order(self) -> None:
        """Begin to cancel the order for the master control."""
        error = self.order.error
        # in version 3, the cause for which a node was not reached is reported until a new order
        if self.version.is_3 and error is not None and error.type == ErrorType.DRIVING.value:
            self.report_order_error(error)
        self.order.cancel()

    def _speed_refused(self, reason: str) -> None:
        _LOG.error("the drive is cancelled: %s", reason)
        self._refused_speed = reason
        self.drive.want(Control.CANCEL)

    def _drive_ended(self, reason: str) -> None:
        """Handle the end of the drive.

        Args:
            reason: why the drive failed, or `UNSENT` if it was not sent; empty after a success.
        """
        if reason == UNSENT:
            self.order.drive_unsent()
        else:
            # a drive that was cancelled because of a refused speed limit failed for that reason
            self.order.drive_ended(self._refused_speed or reason)
        self._refused_speed = ""
        self.link.changed()

    def _link_changed(self, state: LinkState) -> None:
        if state is LinkState.READY:
            self.link_lost_at = math.inf
        else:
            self.link_lost_at = min(self.link_lost_at, boot_time())
            self.order.route.link_lost()
            self._link_was_lost = True
        self.link.changed()

    # Steps

    def execute_commands(self, execute: Callable[[Perform | EndAction], None]) -> None:
        """Execute the commands of the order and of the instant actions until there are no more.

        Then apply the speed limit of the order.

        Args:
            execute: executes a command about an action.
        """
        if self.robot.status is not None and self.robot.status.emergency_stop:
            self.drive.controller.disown_pause()  # so that no end of an action resumes the drive
        while commands := [*self._take_instant(), *self._poll_order()]:
            for command in commands:
                if isinstance(command, Perform | EndAction):
                    execute(command)
                elif isinstance(command, Drive):
                    self.drive.start(leg_task(command.leg, self.robot.position))
                elif command is Control.RESUME:
                    self.drive.controller.end_own_pause()
                else:
                    self.drive.want(command)
        self.speed.limit(self.order.speed_limit)

    def _take_instant(self) -> list[Perform | EndAction]:
        commands, self.instant.commands = self.instant.commands, []
        return commands

    def _poll_order(self) -> list[Command]:
        """Return the next commands of the order; a drive only while nothing else uses the robot."""
        if self._is_driven_otherwise:  # so the robot may leave the last node
            self.order.route.must_check_place = True
        is_free = (
            self.may_act
            and self.robot.is_automatic
            and self._is_located
            and not (self.drive.id or self._must_wait or self.is_leaving_task)
        )
        return self.order.poll(
            may_drive=is_free and not self.tasks.runner.id,
            # a charging task that goes on does not move the robot, and an action may end it; while
            # an action sets the position, the last report may be of the former one
            may_check=is_free and not self.tasks.is_busy and not self._may_be_moved_by_action,
            # cancelOrder itself empties the order, so that both end in the same state message
            may_empty=not self.has_own_motion and not self.instant.runs(CANCEL_ORDER),
        )
