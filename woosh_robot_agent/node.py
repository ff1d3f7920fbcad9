"""The agent's node: puts the link, the services, the topics and the actions together."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import fields
from typing import Any

from woosh_robot_agent.actions.actions import Actions
from woosh_robot_agent.bridge import LinkThread, LoopThread, outcome
from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.link import ChassisClient, LinkError
from woosh_robot_agent.logs import context_of, log_to_ros, speak_as
from woosh_robot_agent.motion.gate import MotionGate
from woosh_robot_agent.parameter_node import ParameterNode
from woosh_robot_agent.parameters import Settings
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.services import Services
from woosh_robot_agent.standard.layer import StandardLayer
from woosh_robot_agent.standard.part_context import PartContext
from woosh_robot_agent.topics import Topics

_LOG = logging.getLogger(__name__)
_STOP_TIMEOUT = 0.4
"""s that the robot gets to answer the last stop."""
_SETTLE_TIMEOUT = 0.5
"""s in which the results of aborted goals must be out."""
_CLOSE_TIMEOUT = 2.0
"""s after which the link is cut at the latest."""
_END_TIMEOUT = 0.3
"""s in which the work that is left over must end."""
_DEBUG_TIMEOUT = 60.0
"""Time that a busy link thread gets to answer `Agent.debug`, in seconds."""


class Agent:
    """The agent of one robot: a node, and behind it the link to the chassis in another thread.

    Attributes:
        node: the node, to be added to an executor.

    Args:
        node: the node; by default one is made.
        thread: where the link runs; by default in a thread of its own. Who hands one over stops it,
            after the end of the agent.
        options: rclpy's options of the node that is made, e.g. `context` and `parameter_overrides`.

    Raises:
        ValueError: a parameter makes no sense.
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
        self._topics = Topics(self.node, self._chassis)  # first: what it cannot read, nobody gets
        known = LastKnown(self._chassis)
        self._services = Services(
            self.node, self._thread, self._chassis, self._gate, known, requests
        )
        self._actions = Actions(
            self.node,
            self._thread,
            self._chassis,
            self._gate,
            known,
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
                known,
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
        """The parameters' values of the moment."""
        return self.node.settings

    def debug(self, timeout: float = _DEBUG_TIMEOUT) -> dict[str, Any]:
        """Return the state of the agent and the size of everything in it that may grow.

        For debugging and for tests: keys may be added at any time. May be called from any thread
        except the link thread.

        Args:
            timeout: Time that the link thread gets to answer, in seconds.

        Returns:
            `state`: The state of the link.
            `requests`: Number of requests in flight.
            `outbox`: Number of frames that wait to be sent.
            `pushes`: Number of pushes that wait to be delivered.
            `counters`: The link's counters, by the names of the attributes of `LinkStats`.
            `goals`: Number of goals whose results have not been sent.
            `running_goals`: Number of goals that the robot may be working on.
            `tasks`: Names of the asyncio tasks in the link thread.

        Raises:
            TimeoutError: The link thread did not answer in time.
        """
        return self._thread.run(self._debug(), timeout)

    async def _debug(self) -> dict[str, Any]:
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        return {
            **_debug_link(self._chassis),
            "goals": self._actions.open_goals,
            "running_goals": self._actions.running_goals,
            "tasks": sorted(task.get_name() for task in tasks),
        }

    def close(self, spin_once: Callable[[], None]) -> None:
        """Stop the robot if the agent drove it, abort the open goals, and end the link.

        Args:
            spin_once: runs the executor for a moment, so that results reach their clients.
        """
        close_all([self], spin_once)

    def _change(self, before: Settings) -> None:
        self._requests.robot_id = self.settings.link.robot_id
        if self.settings.link != before.link:
            config = self.settings.link
            self._thread.spawn(lambda: self._chassis.reconfigure(config))


def _debug_link(chassis: ChassisClient) -> dict[str, Any]:
    """Return the link's part of `Agent.debug`."""
    connection = chassis._connection
    return {
        "state": chassis.state.value,
        "requests": 0 if connection is None else len(connection._pending),
        "outbox": 0 if connection is None else len(connection._outbox),
        "pushes": len(chassis._subscriptions._queue._queue),
        "counters": {
            each.name: getattr(chassis.stats, each.name) for each in fields(chassis.stats)
        },
    }


def close_all(agents: Sequence[Agent], spin_once: Callable[[], None]) -> None:
    """End several agents step by step, each step for all of them at a time; see `Agent.close`."""
    deadline = time.monotonic() + _CLOSE_TIMEOUT
    confirmed = _stop_driving(agents)
    _each(agents, "end of the goals", lambda agent: agent._actions.stop(), _SETTLE_TIMEOUT)
    settled = time.monotonic() + _SETTLE_TIMEOUT
    while any(agent._actions.open_goals for agent in agents) and time.monotonic() < settled:
        spin_once()
    _stop_driving(confirmed)  # another velocity may have come meanwhile
    left = max(deadline - time.monotonic(), 0.1)
    _each(agents, "end of the link", lambda agent: agent._chassis.close(), left)
    _each(agents, "end of the rest", lambda agent: agent._thread.cancel(), _END_TIMEOUT)
    for agent in agents:
        if agent._own_thread is not None:
            agent._own_thread.stop(_END_TIMEOUT)
        if agent.node.executor is not None:  # it would keep what the node consists of
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
    """Take one step of the end; those that succeeded. The next ones come in any case."""
    until = time.monotonic() + timeout
    succeeded = []
    for agent, begun in [(agent, agent._thread.begin(work(agent))) for agent in agents]:
        try:
            outcome(begun, max(until - time.monotonic(), 0.0))
            succeeded.append(agent)
        except (LinkError, TimeoutError) as error:
            agent.node.get_logger().error(f"{what}: {str(error) or 'it took too long'}")
        except Exception:  # a mistake of ours with one robot: the others must be stopped as well
            speak_as(agent.node.get_logger())
            _LOG.exception("%s failed", what)
    return succeeded
