"""The open goals that displace each other, and which of them the chassis runs."""

from __future__ import annotations

import asyncio
from typing import Protocol

from woosh_robot_agent.actions.events import Event, Replaced


class OpenGoal(Protocol):
    """Interface of a goal to the goals that it may displace."""

    @property
    def name(self) -> str:
        """Name under which the chassis reports on the goal."""

    @property
    def accepted(self) -> asyncio.Future[bool]:
        """Becomes True when the chassis accepts the goal, False when it no longer can."""

    def post(self, event: Event) -> None:
        """Hand an event to the goal."""


class OpenGoals:
    """The goals that have not ended, oldest first: those of one call action, or all tasks.

    The chassis executes only one of them at a time.
    """

    def __init__(self) -> None:
        self._goals: list[OpenGoal] = []

    def __len__(self) -> int:
        return len(self._goals)

    def add(self, goal: OpenGoal) -> None:
        """Add a goal as the newest one."""
        self._goals.append(goal)

    def remove(self, goal: OpenGoal) -> None:
        """Remove a goal that ended."""
        self._goals.remove(goal)

    def post(self, event: Event) -> None:
        """Hand an event to every goal."""
        for goal in self._goals:
            goal.post(event)

    def possibly_running(self, name: str) -> int:
        """Return the number of goals of this name that the chassis may be executing."""
        return sum(
            goal.name == name and (not goal.accepted.done() or goal.accepted.result())
            for goal in self._goals
        )

    @property
    def accepted_names(self) -> list[str]:
        """Names of the goals that the chassis has accepted."""
        return [g.name for g in self._goals if g.accepted.done() and g.accepted.result()]

    def replace_older(self, goal: OpenGoal) -> None:
        """Tell all older goals that the chassis accepted `goal` in their place."""
        for older in self._goals[: self._goals.index(goal)]:
            older.post(Replaced())

    async def newer_accepted(self, goal: OpenGoal) -> bool:
        """Return True if the chassis accepts a goal newer than this one; wait until it is known."""
        while True:
            newer = [other.accepted for other in self._goals[self._goals.index(goal) + 1 :]]
            if any(accepted.done() and accepted.result() for accepted in newer):
                return True
            pending = [accepted for accepted in newer if not accepted.done()]
            if not pending:
                return False
            await asyncio.wait(pending, return_when=asyncio.FIRST_COMPLETED)
