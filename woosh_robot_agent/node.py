"""The agent of one robot: its node, and the link, services, topics and actions behind it."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

from woosh_robot_agent.actions.actions import Actions
from woosh_robot_agent.bridge import LinkThread, LoopThread, outcome
from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.link import ChassisClient, LinkError
from woosh_robot_agent.logs import context_of, log_as, log_to_ros
from woosh_robot_agent.motion.gate import MotionGate
from woosh_robot_agent.parameter_node import ParameterNode
from woosh_robot_agent.parameters import Settings
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.services import Services
from woosh_robot_agent.standard.part_context import PartContext
from woosh_robot_agent.standard.standard_layer import StandardLayer
from woosh_robot_agent.topics import Topics

_LOG = logging.getLogger(__name__)
_STOP_TIMEOUT = 0.4
"""Timeout of the last zero velocity, in seconds."""
_SETTLE_TIMEOUT = 0.5
"""Timeout for aborting the open goals and sending their results, in seconds."""
_CLOSE_TIMEOUT = 2.0
"""Maximum time until the link is closed, in seconds."""
_END_TIMEOUT = 0.3
"""Timeout for cancelling the remaining tasks, in seconds."""


class Agent:
    """The agent of one robot: a ROS node, and the link to the chassis in another thread.

    Attributes:
        node: the node, to be added to an executor.

    Args:
        node: the node; by default a new one.
        thread: thread of the link; by default a new one. If you pass a thread, stop it yourself
            after closing the agent.
        options: rclpy's options of a new node, e.g. `context` and `parameter_overrides`.

    Raises:
        ValueError: a parameter is invalid.
    """

    def __init__(
        self,
        node: ParameterNode | None = None,
        thread: LoopThread | None = None,
        **options: Any,
    ) -> None:
        self.node = node or ParameterNode(**options)
        log_to_ros()
        used = thread or LoopThread()
        self._own_thread = None if thread else used
        self._thread = LinkThread(used, context_of(self.node.get_logger()))
        self._chassis = ChassisClient(config=self.settings.link)
        self._gate = MotionGate(self._chassis)
        requests = RequestMaker(self.settings.link.robot_id)
        self._requests = requests
        self._topics = Topics(
            self.node, self._chassis
        )  # first: it reports unreadable pushes before others see them
        last_known = LastKnown(self._chassis)
        self._services = Services(
            self.node, self._thread, self._chassis, self._gate, last_known, requests
        )
        self._actions = Actions(
            self.node,
            self._thread,
            self._chassis,
            self._gate,
            last_known,
            requests,
            lambda: self.settings.goal_link_timeout,
            self.settings.result_timeout,
        )
        self._standard = StandardLayer(
            PartContext(
                self.node,
                self._thread,
                self._chassis,
                self._gate,
                last_known,
                requests,
                self._actions,
                lambda: self.settings.standard,
            )
        )
        self.node.on_change(self._change)
        self._thread.call(self._chassis.start)
        self._standard.start()

    @property
    def settings(self) -> Settings:
        """Current values of the parameters."""
        return self.node.settings

    def close(self, spin_once: Callable[[], None]) -> None:
        """Stop the robot if the agent drives it, abort the open goals, and close the link.

        Args:
            spin_once: runs one executor turn, so that goal results reach their clients.
        """
        close_all([self], spin_once)

    def _change(self, before: Settings) -> None:
        self._requests.robot_id = self.settings.link.robot_id
        if self.settings.link != before.link:
            config = self.settings.link
            self._thread.spawn(lambda: self._chassis.reconfigure(config))


def close_all(agents: Sequence[Agent], spin_once: Callable[[], None]) -> None:
    """Close several agents (see `Agent.close`), taking each step for all of them concurrently."""
    deadline = time.monotonic() + _CLOSE_TIMEOUT
    confirmed = _stop_driving(agents)
    _each(agents, "abort of the goals", lambda agent: agent._actions.stop(), _SETTLE_TIMEOUT)
    settled = time.monotonic() + _SETTLE_TIMEOUT
    while any(agent._actions.open_goals for agent in agents) and time.monotonic() < settled:
        spin_once()
    _stop_driving(confirmed)  # another velocity may have been sent meanwhile
    left = max(deadline - time.monotonic(), 0.1)
    _each(agents, "close of the link", lambda agent: agent._chassis.close(), left)
    _each(agents, "end of the background tasks", lambda agent: agent._thread.cancel(), _END_TIMEOUT)
    for agent in agents:
        if agent._own_thread is not None:
            agent._own_thread.stop(_END_TIMEOUT)
        if agent.node.executor is not None:  # it would keep the entities of the node
            agent.node.executor.remove_node(agent.node)
        agent._actions.destroy()
        agent.node.destroy_node()


def _stop_driving(agents: Sequence[Agent]) -> list[Agent]:
    def stop(agent: Agent) -> Coroutine[Any, Any, None]:
        return agent._gate.stop_driving(_STOP_TIMEOUT)

    return _each(agents, "stop of the robot", stop, 2 * _STOP_TIMEOUT)


def _each(
    agents: Sequence[Agent],
    what: str,
    work: Callable[[Agent], Coroutine[Any, Any, None]],
    timeout: float,
) -> list[Agent]:
    """Take one closing step for all agents; return those for which it succeeded.

    Failures are logged, and do not keep the following steps from being taken.
    """
    until = time.monotonic() + timeout
    succeeded = []
    for agent, begun in [(agent, agent._thread.begin(work(agent))) for agent in agents]:
        try:
            outcome(begun, max(until - time.monotonic(), 0.0))
            succeeded.append(agent)
        except (LinkError, TimeoutError) as error:
            agent.node.get_logger().error(f"{what} failed: {str(error) or 'timeout'}")
        except Exception:  # a bug with one robot must not keep the others from being stopped
            log_as(agent.node.get_logger())
            _LOG.exception("%s failed", what)
    return succeeded
