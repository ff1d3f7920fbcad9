"""Execution of actions as asyncio tasks, with a report of each change of their status."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.vda5050.actions.performer import ActionFailedError
from woosh_robot_agent.vda5050.actions.registry import Registry
from woosh_robot_agent.vda5050.model.order import Action
from woosh_robot_agent.vda5050.model.state import ActionStatus

_LOG = logging.getLogger(__name__)


class ActionRunner:
    """Performs actions at the same time. It does not decide which ones may run together.

    Args:
        registry: the actions of the vehicle.
        on_changed: called with the id of an action, its new status and its result.
    """

    def __init__(
        self, registry: Registry, on_changed: Callable[[str, ActionStatus, str], None]
    ) -> None:
        self._registry = registry
        self._on_changed = on_changed
        self._tasks: dict[str, asyncio.Task[None]] = {}

    def start(self, action: Action) -> None:
        """Start an action."""
        work = self._run(action)
        running = asyncio.get_running_loop().create_task(work, name=f"vda5050 {action.type}")
        self._tasks[action.id] = running
        running.add_done_callback(lambda _: self._tasks.pop(action.id, None))

    def end(self, action: Action) -> None:
        """End an action that runs; it fails, unless it ends by itself before."""
        if action.id in self._tasks:
            self._tasks[action.id].cancel()

    def end_all(self) -> None:
        """End all actions that run; they fail."""
        for task in tuple(self._tasks.values()):
            task.cancel()

    async def close(self) -> None:
        """End all actions, and wait for that."""
        running = tuple(self._tasks.values())
        self.end_all()
        await asyncio.gather(*running, return_exceptions=True)

    async def _run(self, action: Action) -> None:
        self._on_changed(action.id, ActionStatus.RUNNING, "")
        try:
            result = await self._registry.get(action.type).perform(action)
        except asyncio.CancelledError:
            self._on_changed(action.id, ActionStatus.FAILED, "the action was ended")
            raise
        except (ActionFailedError, LinkError) as error:
            self._on_changed(action.id, ActionStatus.FAILED, str(error))
        except Exception:
            _LOG.exception("%s failed by an error of the program", action.type)
            self._on_changed(action.id, ActionStatus.FAILED, "an error of the program; see its log")
        else:
            self._on_changed(action.id, ActionStatus.FINISHED, result)
