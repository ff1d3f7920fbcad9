"""Publishers whose subscribers come and go."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile

from woosh_robot_agent.ros_release import (
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
