"""Publishers of latched topics, and events for subscribers that come and go."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.qos import QoSProfile

from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.ros.bridge import LinkThread
from woosh_robot_agent.ros.qos import latched
from woosh_robot_agent.ros.rclpy_private import PEER_GONE_ERRORS
from woosh_robot_agent.ros.releases import (
    PublisherEventCallbacks,
    UnsupportedEventTypeError,
    subscriber_event_handlers,
)

POLL_PERIOD = 0.1
"""Period of the checks for subscribers if there are no events for them, in seconds."""
_NO_CALLBACKS = PublisherEventCallbacks(use_default_callbacks=False)


class SubscriberEvents:
    """A callback for publishers whose subscribers come or go.

    rclpy's `create_publisher` takes such a callback, too. If the middleware has no such events, it
    destroys the new publisher and raises an error. A second publisher of the topic would then
    follow the first at once, and subscribers sometimes do not discover it. Here, each publisher is
    created once.

    Args:
        callback: called whenever a subscriber comes or goes; must be thread-safe.

    Attributes:
        callback: as given.
        supported: False if the middleware or this release has no such events. Known once a
            publisher exists. The owner then checks for subscribers every `POLL_PERIOD`.
    """

    def __init__(self, callback: Callable[[], None]) -> None:
        self.callback = callback
        self.supported = True

    def attach(self, node: Any, publisher: Any) -> None:
        """Call the callback from now on for a publisher of a node."""
        try:
            handlers = subscriber_event_handlers(node, publisher, self.callback)
        except UnsupportedEventTypeError:
            self.supported = False
            return
        publisher.event_handlers += handlers  # `Node.destroy_publisher` destroys them, too
        for handler in handlers:
            node.add_waitable(handler)


def create_publisher(
    node: Any,
    message_class: Any,
    name: str,
    profile: QoSProfile,
    events: SubscriberEvents | None = None,
) -> Any:
    """Return a new publisher of a node, without rclpy's default callbacks.

    The default callbacks would keep a destroyed publisher alive for some time.

    Args:
        node: owner of the publisher.
        message_class: ROS class of the topic.
        name: name of the topic.
        profile: quality of service.
        events: callback for subscribers that come or go.
    """
    publisher = node.create_publisher(message_class, name, profile, event_callbacks=_NO_CALLBACKS)
    if events is not None:
        events.attach(node, publisher)
    return publisher


_CHECK_PERIOD = 0.25
"""Period of the checks for subscribers, in seconds. Each check wakes the link thread."""


class LatchedPublishers:
    """Creates publishers of latched topics, and replaces them when the link turns to another robot.

    DDS keeps the last messages of a latched topic for late subscribers as long as their publisher
    exists. So it is replaced, in the executor thread, to which all ROS entities belong.

    Args:
        node: owner of the publishers.
        thread: the link thread.
        chassis: the link.
    """

    def __init__(self, node: Any, thread: LinkThread, chassis: ChassisClient) -> None:
        self._node = node
        self._thread = thread
        self._publishers: list[LatchedPublisher] = []
        chassis.on_robot_changed(self._forget)
        thread.spawn(self._watch_subscribers)

    def create(self, message_class: Any, name: str, depth: int) -> LatchedPublisher:
        """Return a publisher.

        Args:
            message_class: ROS class of the topic.
            name: name of the topic.
            depth: number of messages that late subscribers get.
        """
        publisher = LatchedPublisher(
            partial(create_publisher, self._node, message_class, name, latched(depth)),
            self._node.destroy_publisher,
            depth,
        )
        self._publishers.append(publisher)
        return publisher

    def withdraw(self) -> None:
        """Take back everything at once; in the executor thread.

        Call it when the link is about to turn to another robot. What is published until then is
        not sent.
        """
        for publisher in self._publishers:
            publisher.withdraw()

    def take_back(self, *publishers: LatchedPublisher) -> None:
        """Take back what publishers have published so far; in the link thread."""
        for publisher in publishers:
            publisher.forget()
        executor = self._node.executor
        if executor is None:  # nothing uses the node's entities yet
            self._renew()
        else:
            executor.create_task(self._renew)

    def _forget(self) -> None:
        self.take_back(*self._publishers)

    async def _watch_subscribers(self) -> None:
        # not by events: rclpy's EventsExecutor may crash if a publisher with events is destroyed
        # (ros2/rclpy#1644)
        while True:
            await asyncio.sleep(_CHECK_PERIOD)
            for publisher in self._publishers:
                publisher.check_subscribers()

    def _renew(self) -> None:
        for publisher in self._publishers:
            if (successor := publisher.renew()) is not None:
                self._thread.call(publisher.install, successor)


class LatchedPublisher:
    """A publisher of one latched topic; see `LatchedPublishers`. The link thread publishes.

    Args:
        create: creates rclpy's publisher.
        destroy: destroys one.
        depth: number of messages that late subscribers get.
    """

    def __init__(
        self, create: Callable[[], Any], destroy: Callable[[Any], Any], depth: int
    ) -> None:
        self._create = create
        self._destroy = destroy
        self._publisher: Any = create()
        """rclpy's publisher; None while it is being replaced."""
        self._used = False
        """True if the publisher has published something."""
        self._withdrawn: list[Any] = []
        """Publishers to be destroyed in the executor thread."""
        self._waiting: deque[Any] = deque(maxlen=depth)
        """Messages for the next publisher."""
        self._on_subscribers: Callable[[], None] | None = None
        self._subscribers: int | None = None
        """Number of subscribers of this publisher at the last check."""

    def on_subscribers(self, callback: Callable[[], None]) -> None:
        """Register a function that the link thread calls when subscribers have come or gone.

        It is called within `_CHECK_PERIOD`.
        """
        self._on_subscribers = callback

    def check_subscribers(self) -> None:
        """Call the function of `on_subscribers` if their number has changed; in the link thread."""
        if self._on_subscribers is None or self._publisher is None:
            return
        if (count := self.get_subscription_count()) != self._subscribers:
            self._subscribers = count
            self._on_subscribers()

    def publish(self, message: Any) -> None:
        """Publish a message, as soon as there is a publisher."""
        publisher = self._publisher
        if publisher is None:
            self._waiting.append(message)
            return
        self._used = True
        try:
            publisher.publish(message)
        except PEER_GONE_ERRORS:
            if publisher is self._publisher:  # otherwise it was withdrawn at this moment
                raise

    def get_subscription_count(self) -> int:
        """Return the number of subscribers."""
        publisher = self._publisher
        try:
            return 0 if publisher is None else int(publisher.get_subscription_count())
        except PEER_GONE_ERRORS:
            return 0  # withdrawn at this moment

    def withdraw(self) -> None:
        """Take back what was published; in the executor thread."""
        if self._used and self._publisher is not None:
            publisher, self._publisher = self._publisher, None
            self._destroy(publisher)

    def forget(self) -> None:
        """Forget the published and the waiting messages; in the link thread."""
        self._waiting.clear()
        if self._used and self._publisher is not None:
            self._withdrawn.append(self._publisher)
            self._publisher = None

    def renew(self) -> Any:
        """Destroy former publishers, and return a new one if it is needed; in the executor thread.

        Returns:
            The new publisher, to be passed to `install`; None if there is one already.
        """
        while self._withdrawn:
            self._destroy(self._withdrawn.pop())
        if self._publisher is not None or not self._used:
            return None
        self._used = False
        return self._create()

    def install(self, publisher: Any) -> None:
        """Publish with a new publisher from now on; in the link thread."""
        self._publisher = publisher
        self._subscribers = None
        while self._waiting:
            self.publish(self._waiting.popleft())
