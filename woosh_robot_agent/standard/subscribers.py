"""The subscribers of a set of publishers, so that messages are made only on demand."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

from woosh_robot_agent.standard.part_context import PartContext
from woosh_robot_agent.subscriber_events import POLL_PERIOD, SubscriberEvents


class Subscribers:
    """The subscribers of a set of publishers. Use it in the link thread.

    Waiting for the first subscriber costs nothing: the middleware reports each one by an event.

    Args:
        context: the context of the part.
    """

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._publishers: list[Any] = []
        self._changed = asyncio.Event()
        """Set when a subscriber comes or goes."""
        self._present = False
        """Value of `present` when the middleware was last asked."""
        self._events = SubscriberEvents(lambda: self._context.robot.thread.call(self._changed.set))

    def publisher(self, name: str) -> Any:
        """Return a publisher for a topic in `endpoints.STANDARD`, and add it to the set."""
        publisher = self._context.publisher(name, self._events)
        self._publishers.append(publisher)
        self._changed.set()
        return publisher

    @property
    def present(self) -> bool:
        """True if there is at least one subscriber."""
        if self._changed.is_set() or not self._events.supported:
            # cleared before the look: a subscriber that comes after the look sets it again
            self._changed.clear()
            self._present = any(each.get_subscription_count() for each in self._publishers)
        return self._present

    async def times(self, rate: Callable[[], float]) -> AsyncIterator[float]:
        """Yield the loop's time at a fixed rate while there are subscribers.

        The first time comes with the first subscriber. Missed times are skipped. Small delays do
        not add up.

        Args:
            rate: returns the current rate, in Hz.
        """
        loop = asyncio.get_running_loop()
        due = -1.0
        while True:
            if not self.present:
                await self._wait()
                due = loop.time()
            yield loop.time()
            due = max(due + 1.0 / rate(), loop.time())
            await asyncio.sleep(due - loop.time())

    async def _wait(self) -> None:
        while not self.present:
            await (self._changed.wait() if self._events.supported else asyncio.sleep(POLL_PERIOD))
