"""Publishers, and work that is done only while a topic has subscribers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

from rclpy.qos import QoSProfile

from woosh_robot_agent.link import ChassisClient, LinkState
from woosh_robot_agent.ros.bridge import LinkThread
from woosh_robot_agent.ros.releases import (
    PublisherEventCallbacks,
    UnsupportedEventTypeError,
    subscriber_event_handlers,
)

POLL_PERIOD = 1.0
"""Period of the checks for subscribers if the middleware does not report them, in seconds."""
_NO_CALLBACKS = PublisherEventCallbacks(use_default_callbacks=False)
"""Leaves out rclpy's default callbacks, each of which is one more entity of the executor."""


def create_publisher(node: Any, message_class: Any, name: str, profile: QoSProfile) -> Any:
    """Return a new publisher of a node, without the entities of rclpy's default callbacks."""
    return node.create_publisher(message_class, name, profile, event_callbacks=_NO_CALLBACKS)


def publish_readiness(
    chassis: ChassisClient, publisher: Any, message: Callable[[bool], Any]
) -> None:
    """Publish False now, before the link is started, and each change of whether it is ready.

    Args:
        message: returns the message for True or False.
    """
    published = False

    def changed(state: LinkState) -> None:
        nonlocal published
        if published != (state is LinkState.READY):
            published = not published
            publisher.publish(message(published))

    publisher.publish(message(published))
    chassis.on_state(changed)


class Subscribers:
    """The subscribers of a set of publishers. Use it in the link thread.

    The middleware reports each subscriber that comes or goes by an event. Humble and some
    middleware have no such events; there, the subscribers are counted every `POLL_PERIOD`.
    """

    def __init__(self, node: Any, thread: LinkThread) -> None:
        self._node = node
        self._thread = thread
        self._publishers: list[Any] = []
        self._has_events = True
        """False if the middleware does not report subscribers by events."""
        self._changed = asyncio.Event()
        """Set when a subscriber comes or goes."""
        self._present = False
        """Value of `present` when the middleware was last asked."""
        self._valid_until = 0.0
        """Monotonic time until which `_present` is valid without events."""

    def publisher(self, message_class: Any, name: str, profile: QoSProfile) -> Any:
        """Create a publisher and add it to the set."""
        # The callback for matched events is not passed to rclpy's `create_publisher`: on middleware
        # without these events, that raises an error and destroys the new publisher. Subscribers
        # sometimes do not discover the second publisher that would have to be created in its place.
        publisher = create_publisher(self._node, message_class, name, profile)
        try:
            handlers = subscriber_event_handlers(
                self._node, publisher, partial(self._thread.call, self._changed.set)
            )
        except UnsupportedEventTypeError:
            self._has_events = False
        else:
            publisher.event_handlers += handlers  # `Node.destroy_publisher` destroys them, too
            for handler in handlers:
                self._node.add_waitable(handler)
        self._publishers.append(publisher)
        self._changed.set()  # the subscribers of this publisher have not been counted yet
        return publisher

    @property
    def present(self) -> bool:
        """True if there is at least one subscriber."""
        now = time.monotonic()
        is_poll_due = not self._has_events and now >= self._valid_until
        if self._changed.is_set() or is_poll_due:
            # cleared before counting: a subscriber that comes later sets it again
            self._changed.clear()
            self._present = any(each.get_subscription_count() for each in self._publishers)
            self._valid_until = _next_poll(now)
        return self._present

    async def wait(self, *, present: bool) -> None:
        """Wait until there is at least one subscriber, or until there is none."""
        while self.present != present:
            if self._has_events:
                await self._changed.wait()
            else:  # at multiples of the period, so that all `Subscribers` wake the loop together
                now = time.monotonic()
                await asyncio.sleep(_next_poll(now) - now)

    async def repeat(
        self, rate: Callable[[], float], work: Callable[[float], Coroutine[Any, Any, None]]
    ) -> None:
        """Do work at a fixed rate while there are subscribers, until cancelled.

        The work is first done when the first subscriber comes. Times missed because the work takes
        long, or for other reasons, are skipped. Small delays do not add up.

        Args:
            rate: returns the current rate, in Hz.
            work: called with the loop time. Its exceptions end the repetition.
        """
        clock = asyncio.get_running_loop().time
        while True:
            await self.wait(present=True)
            due = clock()
            while self.present:
                await work(clock())
                due = max(due + 1.0 / rate(), clock())
                await asyncio.sleep(due - clock())


def _next_poll(now: float) -> float:
    """Return the next multiple of `POLL_PERIOD`."""
    return (now // POLL_PERIOD + 1) * POLL_PERIOD
