"""What the parts of the standard layer share: a base class, a context, subscribers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from functools import partial
from typing import Any

from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.link.tasks import start_task
from woosh_robot_agent.parameters import StandardSettings
from woosh_robot_agent.robot.watch import Watch
from woosh_robot_agent.ros.bridge import DeferredService, Reply
from woosh_robot_agent.ros.context import RobotContext
from woosh_robot_agent.ros.latched import (
    POLL_PERIOD,
    LatchedPublishers,
    SubscriberEvents,
    create_publisher,
)
from woosh_robot_agent.ros.logs import log_as
from woosh_robot_agent.ros.qos import latched, reliable
from woosh_robot_agent.ros.releases import WithMessageInfo
from woosh_robot_agent.ros.second_agent import SecondAgent
from woosh_robot_agent.ros.standard.endpoints import BY_NAME, Kind


class Part:
    """One part of the standard layer: usually one topic or service."""

    async def run(self) -> None:
        """Do the periodic work of the part in the link thread, until cancelled.

        By default there is none: the part only reacts to messages and requests.
        """

    def close(self) -> None:
        """Remove what `Node.destroy_node` leaves in the graph, in the executor thread."""


@dataclass(frozen=True)
class PartContext:
    """The objects and helper methods that the parts share.

    Attributes:
        robot: the objects shared with the services and actions. The parts run in its link thread.
        latched: creates the publishers of latched topics.
        watch: observers of the robot.
        second_agent: search for a second agent.
        settings: returns the current parameter values.
    """

    robot: RobotContext
    latched: LatchedPublishers
    watch: Watch
    second_agent: SecondAgent
    settings: Callable[[], StandardSettings]

    def frame(self, which: str) -> str:
        """Return the name of the frame `map`, `odom`, `base` or `scan`, with the prefix."""
        settings = self.settings()
        return settings.frame_prefix + str(getattr(settings, f"{which}_frame"))

    def now(self) -> Any:
        """Return the node's current time as builtin_interfaces/Time."""
        return self.robot.node.get_clock().now().to_msg()

    def publisher(
        self,
        name: str,
        events: SubscriberEvents | None = None,
        *,
        about_robot: bool = True,
    ) -> Any:
        """Return a publisher for a topic in `endpoints.STANDARD`; the link thread may use it.

        Args:
            name: name of the topic.
            events: callback for subscribers that come or go.
            about_robot: withdraw the messages of a latched topic when the link turns to another
                robot.
        """
        endpoint = BY_NAME[name]
        if endpoint.kind is Kind.LATCHED and about_robot:
            publisher = self.latched.create(class_of(endpoint.type), name, endpoint.depth)
            if events is not None:
                publisher.on_subscribers(events.callback)
            return publisher
        profile = latched if endpoint.kind is Kind.LATCHED else reliable
        return create_publisher(
            self.robot.node, class_of(endpoint.type), name, profile(endpoint.depth), events
        )

    def subscribe(
        self,
        name: str,
        callback: Callable[..., None],
        type_name: str = "",
        *,
        in_executor: bool = False,
        with_info: bool = False,
    ) -> None:
        """Subscribe to a topic in `endpoints.STANDARD`.

        Args:
            name: name of the topic.
            callback: called with each message in the link thread; must not block.
            type_name: ROS type of the topic, if it differs from that in `endpoints.STANDARD`.
            in_executor: call `callback` in the executor thread instead.
            with_info: call `callback` with each message, rclpy's information about it, and the
                monotonic time at which it was taken from the middleware.
        """
        endpoint = BY_NAME[name]
        call = self._logging(callback) if in_executor else partial(self.robot.thread.call, callback)
        self.robot.node.create_subscription(
            class_of(type_name or endpoint.type),
            name,
            WithMessageInfo(lambda message, info: call(message, info, time.monotonic()))
            if with_info
            else call,
            reliable(endpoint.depth),
        )

    def service(self, name: str, handle: Callable[[Any, Reply], None]) -> DeferredService:
        """Create a service in `endpoints.STANDARD`; `handle` runs in the executor thread."""
        return DeferredService(self.robot.node, class_of(BY_NAME[name].type, "srv"), name, handle)

    def _logging(self, callback: Callable[..., None]) -> Callable[..., None]:
        """Wrap a callback for the executor thread, so that it logs to the node's logger."""

        def call(*arguments: Any) -> None:
            log_as(self.robot.node.get_logger())
            callback(*arguments)

        return call


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
