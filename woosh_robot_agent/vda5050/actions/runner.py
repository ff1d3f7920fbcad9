"""The actions of a vehicle, and their execution as asyncio tasks."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Iterable, Mapping
from itertools import islice, takewhile
from pathlib import Path

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.motion.timeliness import boot_time
from woosh_robot_agent.sentences import Sentence, said_by
from woosh_robot_agent.vda5050.actions import control, map_actions, robot_actions
from woosh_robot_agent.vda5050.actions.performing import Run, VehicleAction
from woosh_robot_agent.vda5050.execution import Execution
from woosh_robot_agent.vda5050.messages.factsheet import ActionTypes
from woosh_robot_agent.vda5050.messages.order import Action
from woosh_robot_agent.vda5050.messages.state import (
    NOT_AUTOMATIC,
    ActionFailedError,
    ActionStatus,
    ErrorType,
)
from woosh_robot_agent.vda5050.messages.versions import Version
from woosh_robot_agent.vda5050.orders.actions import count_startable
from woosh_robot_agent.vda5050.orders.legs import EndAction, Perform, need_standstill
from woosh_robot_agent.vda5050.reports import Reports

ACTIONS: Mapping[str, VehicleAction] = {
    action.type.name: action
    for action in (
        control.start_pause,
        control.stop_pause,
        control.cancel_order,
        control.factsheet_request,
        control.state_request,
        robot_actions.start_charging,
        robot_actions.stop_charging,
        robot_actions.pick,
        robot_actions.drop,
        map_actions.enable_map,
        map_actions.download_map,
        map_actions.delete_map,
        robot_actions.lift_to,
        robot_actions.step,
        robot_actions.rotate,
        robot_actions.switch_footprint,
        robot_actions.speak,
        map_actions.init_position,
        map_actions.initialize_position,
        control.clear_instant_actions,
        control.log_report,
    )
}
"""All actions, by name."""


def action_types(version: Version, *, can_log: bool = False) -> ActionTypes:
    """Return the actions of a vehicle, by name; logReport only if `can_log`."""
    return {
        name: action.type
        for name, action in ACTIONS.items()
        if version.number.startswith(action.version)
        and (can_log or action is not control.log_report)
    }


_LOG = logging.getLogger(__name__)
_PROGRAM = Sentence("an error of the program; see its log")
_MAX_LOSS = 30.0
"""Time without a link, or of a stall, after which no instant action waits, in seconds."""


class ActionRunner:
    """Performs actions as far as their blocking types permit.

    `OrderMachine` commands the actions of an order once they may run together. This class also
    makes them and the instant actions wait for each other.
    """

    def __init__(self, execution: Execution, reports: Reports, log_folder: Path | None) -> None:
        self._execution = execution
        self._reports = reports
        self._log_folder = log_folder
        self._waiting: dict[str, Action] = {}
        """Actions that have not started, by id, in the order in which they must start."""
        self._running: dict[str, asyncio.Task[None]] = {}
        """The asyncio tasks of the actions that run, by id."""
        self._end_reasons: dict[str, str] = {}
        """Reasons why actions are being ended, by id."""
        self._stall_ended = -math.inf
        """The gate's `stall_ended` at the last call of `poll`."""

    def execute(self, command: Perform | EndAction) -> None:
        """Start an action as soon as its blocking type permits, or end it."""
        action = command.action
        if isinstance(command, EndAction):
            self._end(action, command.reason)
        elif command.at_once:
            self._start(action)
        else:
            self._waiting[action.id] = action
            self._execution.action_changed(action.id, ActionStatus.WAITING)
            self.poll()  # now: the next command may be the drive away from its node

    def _end(self, action: Action, reason: str) -> None:
        """End an action, which fails for this reason unless it has ended by itself before.

        An action that moves nothing cannot be interrupted once it runs, and ends by itself.
        """
        if self._waiting.pop(action.id, None) is not None:
            self._execution.action_changed(action.id, ActionStatus.FAILED, reason)
        elif not ACTIONS[action.type].type.moves:
            return
        elif action.id in self._running and action.id not in self._end_reasons:
            # once: a second cancellation would end the wait for the robot's end of the action
            self._end_reasons[action.id] = reason
            self._running[action.id].cancel()

    def _end_motion(self, reason: str) -> None:
        """End the actions that move something: people have stopped the robot, or may have.

        Otherwise the robot might begin them at once, or go on with them in automatic mode.
        """
        for action in (*self._waiting.values(), *self._execution.active.values()):
            if ACTIONS[action.type].type.moves:
                self._end(action, reason)

    def _end_forgotten(self) -> None:
        """End the instant actions that have not begun if the link was lost for long.

        Otherwise they might begin when the robot is switched on hours later: move something, or set
        a position that is not right any more. The same holds after a suspension of this computer.
        """
        execution, gate = self._execution, self._execution.link.gate
        before, self._stall_ended = self._stall_ended, gate.stall_ended
        if self._stall_ended > before and gate.stall_duration > _MAX_LOSS:
            cause = "the connector was suspended"
        elif boot_time() >= execution.link_lost_at + _MAX_LOSS:
            cause = "there was no link to the robot"
        else:
            return
        early = (ActionStatus.WAITING, ActionStatus.INITIALIZING)
        not_begun = {each.id for each in execution.instant.states if each.status in early}
        for action in (*self._waiting.values(), *execution.active.values()):
            if action.id in not_begun:
                self._end(
                    action, f"{cause} for {_MAX_LOSS:g} s before the action began; send it again"
                )

    def poll(self) -> None:
        """Start the actions that may start now.

        If the robot is not in automatic mode, first end the actions that move something. After a
        long loss of the link, or a long stall of this program, end the instant ones that have not
        begun.
        """
        execution = self._execution
        if not execution.robot.is_automatic:
            self._end_motion(NOT_AUTOMATIC())
        self._end_forgotten()
        waiting: Iterable[Action] = self._waiting.values()
        if execution.link.is_closing or not execution.may_act:
            return
        if execution.pause_wanted:  # an action that moves something waits, with all behind it
            waiting = takewhile(lambda each: not ACTIONS[each.type].type.moves, waiting)
        active = execution.active
        count = count_startable(waiting, active.values(), driving=execution.is_driving)
        for action in list(islice(self._waiting.values(), count)):
            del self._waiting[action.id]
            active[action.id] = action
            # saved before it begins: an action that is WAITING in the state file has not begun
            execution.action_changed(action.id, ActionStatus.INITIALIZING)
            self._start(action)

    def _start(self, action: Action) -> None:
        running = self._execution.link.background.start(self._run(action))
        self._running[action.id] = running
        running.add_done_callback(lambda task: self._task_done(action, task))

    def _task_done(self, action: Action, task: asyncio.Task[None]) -> None:
        """Let an action fail if its task was cancelled; `_run` has stored any other end."""
        if self._running.get(action.id) is task:
            self._ended(action, ActionStatus.FAILED, self._end_reasons.get(action.id, ""))

    async def _run(self, action: Action) -> None:
        """Perform an action, and store its status until it has ended."""

        def report(status: ActionStatus) -> None:
            self._execution.action_changed(action.id, status)

        definition = ACTIONS[action.type]
        run = Run(action, report, self._execution, self._reports, self._log_folder)
        try:
            if definition.type.moves:
                await run.wait_until_permitted()
                report(ActionStatus.INITIALIZING)  # RUNNING once the robot has accepted it
            else:
                report(ActionStatus.RUNNING)
            result = await definition.perform(run)
        except ActionFailedError as error:
            self._failed(action, said_by(error), error.kind)
        except LinkError as error:
            self._failed(action, said_by(error), ErrorType.ACTION)
        except Exception:
            _LOG.exception("%s failed because of an error of the program", action.type)
            self._failed(action, _PROGRAM(), ErrorType.ACTION)
        else:
            self._ended(action, ActionStatus.FINISHED, result or "")

    def _failed(self, action: Action, reason: str, kind: ErrorType) -> None:
        _LOG.warning("%s failed: %s", action.type, reason)
        self._execution.action_failed(action, reason, kind)
        self._ended(action, ActionStatus.FAILED, reason)
        if kind is ErrorType.INTERRUPTED and need_standstill((action,)):
            self._end_motion(
                f"{action.type} was interrupted: {reason}; send this action again when the robot "
                "may go on"
            )

    def _ended(self, action: Action, status: ActionStatus, result: str) -> None:
        """Forget an action that has ended, and store its final status and result."""
        self._execution.active.pop(action.id, None)
        self._running.pop(action.id, None)
        self._end_reasons.pop(action.id, None)
        # when the connector ends, the robot goes on, and the action must not count as ended
        if not self._execution.link.is_closing:
            self._execution.action_changed(action.id, status, result)
