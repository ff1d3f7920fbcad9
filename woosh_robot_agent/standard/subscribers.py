"""The subscribers of a set of publishers, so that messages are made only on demand."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from woosh_robot_agent.link.tasks import start_task
from woosh_robot_agent.standard.part_context import PartContext
from woosh_robot_agent.subscriber_events import POLL_PERIOD, SubscriberEvents


class Subscribers:
    """The subscribers of a set of publishers. Use it in the link thread.

    The middleware reports each subscriber by an event; `LatchedPublishers` checks for those of
    latched topics.

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

    async def repeat(
        self, rate: Callable[[], float], work: Callable[[float], Coroutine[Any, Any, None]]
    ) -> None:
        """Do work at a fixed rate while there are subscribers, until cancelled.

        It is first done for the first subscriber. Missed times are skipped, those during the work
        too. Small delays do not add up.

        Args:
            rate: returns the current rate, in Hz.
            work: called with the loop's time. Its exceptions end the repetition.
        """
        while True:
            await self._wait()
            repetition = _Repetition(self, rate, work)
            try:
                await repetition.ended
            finally:
                repetition.cancel()

    async def _wait(self) -> None:
        while not self.present:
            await (self._changed.wait() if self._events.supported else asyncio.sleep(POLL_PERIOD))


class _Repetition:
    """Work that is repeated while there are subscribers.

    A timer starts the work, without a turn of the event loop for a task that waits for the timer.

    Args:
        subscribers: the subscribers.
        rate: as in `Subscribers.repeat`.
        work: as in `Subscribers.repeat`.

    Attributes:
        ended: future that is done when there are no more subscribers, or the work has failed.
    """

    def __init__(
        self,
        subscribers: Subscribers,
        rate: Callable[[], float],
        work: Callable[[float], Coroutine[Any, Any, None]],
    ) -> None:
        self._subscribers = subscribers
        self._rate = rate
        self._work = work
        self._loop = asyncio.get_running_loop()
        self._due = self._loop.time()
        self.ended: asyncio.Future[None] = self._loop.create_future()
        self._timer = self._loop.call_soon(self._start)
        self._task: asyncio.Task[None] | None = None

    def cancel(self) -> None:
        """End the repetition and the work."""
        self._timer.cancel()
        if self._task is not None:
            self._task.cancel()

    def _start(self) -> None:
        if self._subscribers.present:
            self._task = start_task(self._do())
        elif not self.ended.done():
            self.ended.set_result(None)

    async def _do(self) -> None:
        try:
            await self._work(self._loop.time())
        except Exception as error:
            if not self.ended.done():
                self.ended.set_exception(error)
            return
        self._due = max(self._due + 1.0 / self._rate(), self._loop.time())
        self._timer = self._loop.call_at(self._due, self._start)
