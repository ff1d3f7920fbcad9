"""Execution of actions as asyncio tasks, with a report of each change of their status."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from itertools import takewhile
from typing import Protocol

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.actions.robot_calls import ActionFailedError, Pause
from woosh_robot_agent.vda5050.messages.order import Action
from woosh_robot_agent.vda5050.messages.state import ActionStatus, ErrorType
from woosh_robot_agent.vda5050.orders.actions import startable

_LOG = logging.getLogger(__name__)
_ENDED = "the action was ended"


class Watcher(Protocol):
    """Receives the progress of actions."""

    def action_changed(self, action_id: str, status: ActionStatus, result: str) -> None:
        """Take the new status of an action, and its result."""

    def action_failed(self, action: Action, reason: str, kind: ErrorType) -> None:
        """Take the reason why an action failed by itself; called before its new status."""


class ActionRunner:
    """Performs actions as far as their blocking types permit.

    An action of an order is started here once the order permits it. Actions of the order and
    instant actions wait for each other if their blocking types demand it.

    Args:
        registry: the actions of the vehicle.
        pause: the pause of the vehicle, in which no action starts that moves something.
        may_act: returns True while actions may begin that do not ignore the blocking types.
        is_driving: returns True while the vehicle drives along the order.
        watcher: receives the progress of the actions.
    """

    def __init__(
        self,
        registry: Registry,
        pause: Pause,
        may_act: Callable[[], bool],
        is_driving: Callable[[], bool],
        watcher: Watcher,
    ) -> None:
        self._registry = registry
        self._pause = pause
        self._may_act = may_act
        self._is_driving = is_driving
        self._watcher = watcher
        self._waiting: list[Action] = []
        """Actions that have not started, in the order in which they must start."""
        self._active: dict[str, Action] = {}
        """Actions that run and for which others may have to wait, by id."""
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._closing = False

    @property
    def busy(self) -> bool:
        """True while an action runs for which others may have to wait."""
        return bool(self._active)

    def start(self, action: Action, *, at_once: bool = False) -> None:
        """Start an action as soon as its blocking type permits.

        Args:
            action: the action.
            at_once: ignore the blocking types.
        """
        if at_once:
            self._launch(action)
            return
        self._waiting.append(action)
        self.poll()
        if action in self._waiting:
            self._watcher.action_changed(action.id, ActionStatus.WAITING, "")

    def poll(self) -> None:
        """Start the actions that may start now."""
        if self._closing or not self._may_act():
            return
        waiting = self._waiting
        if self._pause.wanted:
            waiting = list(takewhile(lambda each: not self._moves(each), waiting))
        count = startable(waiting, self._active.values(), driving=self._is_driving())
        started, self._waiting = self._waiting[:count], self._waiting[count:]
        for action in started:
            self._active[action.id] = action
            self._launch(action)

    def end(self, action: Action) -> None:
        """End an action; it fails, unless it ends by itself before."""
        if action in self._waiting:
            self._waiting.remove(action)
            self._watcher.action_changed(action.id, ActionStatus.FAILED, _ENDED)
        elif action.id in self._tasks:
            self._tasks[action.id].cancel()

    def end_all(self) -> None:
        """End all actions; they fail."""
        waiting, self._waiting = self._waiting, []
        for action in waiting:
            self._watcher.action_changed(action.id, ActionStatus.FAILED, _ENDED)
        for task in tuple(self._tasks.values()):
            task.cancel()

    async def close(self) -> None:
        """Stop following the actions. The robot goes on with them."""
        self._closing = True
        running = tuple(self._tasks.values())
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)

    def _moves(self, action: Action) -> bool:
        return self._registry.get(action.type).type.pausable

    def _launch(self, action: Action) -> None:
        work = self._run(action)
        running = asyncio.get_running_loop().create_task(work, name=f"vda5050 {action.type}")
        self._tasks[action.id] = running
        running.add_done_callback(lambda task: self._done(action, task))

    def _done(self, action: Action, task: asyncio.Task[None]) -> None:
        """Let an action fail that was ended before it began; others have reported their end."""
        if self._tasks.get(action.id) is task:
            self._ended(action, ActionStatus.FAILED, _ENDED)

    async def _run(self, action: Action) -> None:
        def report(status: ActionStatus) -> None:
            self._watcher.action_changed(action.id, status, "")

        performer = self._registry.get(action.type)
        # an action that moves something is RUNNING once the robot has accepted it
        report(ActionStatus.INITIALIZING if performer.type.pausable else ActionStatus.RUNNING)
        try:
            result = await performer.perform(action, report)
        except asyncio.CancelledError:
            self._ended(action, ActionStatus.FAILED, _ENDED)
            raise
        except ActionFailedError as error:
            self._failed(action, str(error), error.kind)
        except LinkError as error:
            self._failed(action, str(error), ErrorType.ACTION)
        except Exception:
            _LOG.exception("%s failed because of an error of the program", action.type)
            self._failed(action, "an error of the program; see its log", ErrorType.ACTION)
        else:
            self._ended(action, ActionStatus.FINISHED, result)

    def _failed(self, action: Action, reason: str, kind: ErrorType) -> None:
        _LOG.warning("%s failed: %s", action.type, reason)
        self._watcher.action_failed(action, reason, kind)
        self._ended(action, ActionStatus.FAILED, reason)

    def _ended(self, action: Action, status: ActionStatus, result: str) -> None:
        self._active.pop(action.id, None)
        self._tasks.pop(action.id, None)
        if not self._closing:
            self._watcher.action_changed(action.id, status, result)
