"""Who listens to what is published: what nobody listens to need not be made."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, UnsupportedEventTypeError

from woosh_robot_agent.standard.part_context import PartContext

_LOOK_S = 0.1
"""s between two looks for subscribers, where the middleware does not tell of them."""


class Audience:
    """The subscribers of some publishers; used in the link's thread.

    The middleware tells the executor of each one that comes, so that waiting for the first costs
    nothing.

    Args:
        host: see `PartContext`.
    """

    def __init__(self, host: PartContext) -> None:
        self._host = host
        self._publishers: list[Any] = []
        self._changed = asyncio.Event()
        self._told = True

    def publisher(self, name: str) -> Any:
        """A publisher of the table, the subscribers of which belong to this audience."""
        callbacks = PublisherEventCallbacks(matched=self._matched)
        try:
            publisher = self._host.publisher(name, callbacks)
        except UnsupportedEventTypeError:
            publisher = self._host.publisher(name)
            self._told = False
        self._publishers.append(publisher)
        return publisher

    @property
    def present(self) -> bool:
        """Whether anybody subscribes."""
        return any(publisher.get_subscription_count() for publisher in self._publishers)

    async def times(self, rate: Callable[[], float]) -> AsyncIterator[float]:
        """Give the loop's time `rate` times per second, without drift, while anybody subscribes.

        The first comes with the first subscriber. What was missed in between is left out.
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
        while True:
            # in this order: who comes after the look sets it again
            self._changed.clear()
            if self.present:
                return
            await (self._changed.wait() if self._told else asyncio.sleep(_LOOK_S))

    def _matched(self, _change: Any) -> None:
        self._host.thread.call(self._changed.set)
