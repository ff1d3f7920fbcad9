"""Base class of the parts of the standard layer, and the context that the parts share."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.qos import QoSProfile
from std_msgs.msg import Header

from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.parameters import StandardSettings
from woosh_robot_agent.robot.watch import Watch
from woosh_robot_agent.ros.actions.actions import AgentGoal
from woosh_robot_agent.ros.bridge import DeferredService, Reply
from woosh_robot_agent.ros.context import RobotContext
from woosh_robot_agent.ros.entities import UrgentCallbackGroup
from woosh_robot_agent.ros.qos import latched
from woosh_robot_agent.ros.second_agent import SecondAgentDetector
from woosh_robot_agent.ros.standard_endpoints import BY_NAME, Kind
from woosh_robot_agent.ros.subscribers import Subscribers, create_publisher

NO_TIME = "use_sim_time is true, but no time has come on /clock: set it to false, or publish /clock"


class Part:
    """One part of the standard layer: usually one topic or service."""

    async def run(self) -> None:
        """Do the periodic work of the part in the link thread, until cancelled.

        By default a part has no periodic work, and only reacts to messages and requests.
        """


@dataclass(frozen=True)
class PartContext(RobotContext):
    """The objects that the parts share, and methods that create their ROS entities.

    Attributes:
        watch: observers of what the robot does and who drives it.
        second_agent_detector: warns of a second agent in the same namespace.
        settings: returns the current parameter values.
        start_goal: starts a goal of the agent itself; `Actions.start`.
    """

    watch: Watch
    second_agent_detector: SecondAgentDetector
    settings: Callable[[], StandardSettings]
    start_goal: Callable[..., AgentGoal]

    def frame(self, which: str) -> str:
        """Return the name of the frame `map`, `odom`, `base` or `scan`, with the prefix."""
        settings = self.settings()
        return settings.frame_prefix + str(getattr(settings, f"{which}_frame"))

    def header(self, which: str) -> Header:
        """Return a header with the current time and the frame `which`, as for `frame`."""
        return Header(stamp=self.now(), frame_id=self.frame(which))

    def now(self) -> Time:
        """Return the node's current time."""
        seconds, nanoseconds = divmod(self.now_ns(), 1_000_000_000)
        return Time(sec=seconds, nanosec=nanoseconds)

    def now_ns(self) -> int:
        """Return the node's current time, in nanoseconds since 1970 unless time is simulated.

        It is 0 while no time has come on /clock.
        """
        node = self.node
        # rclpy's clock takes a hundred times as long as the system's
        if node.get_parameter("use_sim_time").value:
            return int(node.get_clock().now().nanoseconds)
        return time.time_ns()

    def publisher(self, name: str, subscribers: Subscribers | None = None) -> Any:
        """Return a publisher for a topic in `standard_endpoints.BY_NAME`, for the link thread.

        Args:
            subscribers: creates the publisher, and counts its subscribers too, so that work can
                stop while there are none.
        """
        endpoint = BY_NAME[name]
        depth = endpoint.depth
        profile = latched(depth) if endpoint.kind is Kind.LATCHED else QoSProfile(depth=depth)
        if subscribers is not None:
            return subscribers.publisher(class_of(endpoint.type), name, profile)
        return create_publisher(self.node, class_of(endpoint.type), name, profile)

    def subscribers(self) -> Subscribers:
        """Return a new `Subscribers`, which creates publishers and counts their subscribers."""
        return Subscribers(self.node, self.thread)

    def subscribe(
        self,
        name: str,
        callback: Callable[..., None],
        type_name: str = "",
        *,
        with_info: bool = False,
        urgent: bool = False,
    ) -> None:
        """Subscribe to a topic in `standard_endpoints.BY_NAME`.

        Args:
            callback: called with each message in the link thread; must not block.
            type_name: ROS type of the topic, if it differs from the type in that table.
            with_info: True to call `callback` with each message, rclpy's information about it, and
                the monotonic time at which it was taken from the middleware.
            urgent: True to receive messages before all other callbacks (`UrgentCallbackGroup`).
        """
        endpoint = BY_NAME[name]
        call = partial(self.thread.call, callback)
        self.node.create_subscription(
            class_of(type_name or endpoint.type),
            name,
            (lambda message, info: call(message, info, time.monotonic())) if with_info else call,
            endpoint.depth,
            callback_group=UrgentCallbackGroup() if urgent else None,
        )

    def service(self, name: str, handle: Callable[[Any, Reply], None], **options: Any) -> None:
        """Create a service in `standard_endpoints.BY_NAME`.

        Args:
            handle: called with each request and its `Reply` in the executor thread; must not block.
                The response may be sent later.
            options: `urgent` and `qos` of `DeferredService`.
        """
        srv = class_of(BY_NAME[name].type, "srv")
        DeferredService(self.node, srv, name, handle, **options)
