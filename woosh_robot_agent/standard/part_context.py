"""What every part of the standard layer works with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from woosh_robot_agent.bridge import DeferredService, LinkThread, Reply
from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.logs import speak_as
from woosh_robot_agent.motion.gate import MotionGate
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.ros_types import class_of
from woosh_robot_agent.standard.settings import StandardSettings
from woosh_robot_agent.standard.table import BY_NAME, Kind


class Part:
    """One part of the standard layer."""

    async def run(self) -> None:
        """Do what is to be done from time to time, in the link's thread, until cancelled.

        Nothing, in a part that only does what it is asked to.
        """


@dataclass(frozen=True)
class PartContext:
    """What the parts share.

    Attributes:
        node: owner of the topics and services.
        thread: runs the link and the parts.
        chassis: to be used in the link's thread only.
        gate: passes commands on.
        known: what the chassis last said.
        requests: makes the chassis's messages.
        settings: gives the parameters' values of the moment.
    """

    node: Any
    thread: LinkThread
    chassis: ChassisClient
    gate: MotionGate
    known: LastKnown
    requests: RequestMaker
    settings: Callable[[], StandardSettings]

    def frame(self, which: str) -> str:
        """The name of a frame, `map`, `odom`, `base` or `scan`, with the prefix."""
        settings = self.settings()
        return settings.frame_prefix + str(getattr(settings, f"{which}_frame"))

    def now(self) -> Any:
        """The agent's time as a stamp (builtin_interfaces/Time)."""
        return self.node.get_clock().now().to_msg()

    def publisher(self, name: str, callbacks: PublisherEventCallbacks | None = None) -> Any:
        """A publisher of the table; it may publish from the link's thread.

        Args:
            name: the topic.
            callbacks: are called in the executor's thread.

        Raises:
            UnsupportedEventTypeError: the middleware has not what `callbacks` wants to be told.
        """
        entry = BY_NAME[name]
        qos = QoSProfile(
            depth=entry.depth,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL
            if entry.kind is Kind.LATCHED
            else DurabilityPolicy.VOLATILE,
        )
        msg = class_of(entry.type, "msg")
        return self.node.create_publisher(msg, name, qos, event_callbacks=callbacks)

    def subscribe(
        self,
        name: str,
        callback: Callable[[Any], None],
        type_name: str = "",
        *,
        in_executor: bool = False,
    ) -> None:
        """Have `callback` called with each message of an input of the table; it must not block.

        Args:
            name: the topic.
            callback: is called in the link's thread.
            type_name: its ROS type where it is not the table's.
            in_executor: call it in the executor's thread instead.
        """
        entry = BY_NAME[name]
        self.node.create_subscription(
            class_of(type_name or entry.type, "msg"),
            name,
            self._speaking(callback) if in_executor else partial(self.thread.call, callback),
            QoSProfile(depth=entry.depth),
        )

    def _speaking(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        def call(message: Any) -> None:
            speak_as(self.node.get_logger())
            callback(message)

        return call

    def service(self, name: str, handle: Callable[[Any, Reply], None]) -> DeferredService:
        """Offer a service of the table; `handle` runs in the executor's thread."""
        return DeferredService(self.node, class_of(BY_NAME[name].type, "srv"), name, handle)
