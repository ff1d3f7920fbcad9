"""The agent's node: puts the link, the services, the topics and the actions together."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Coroutine, Sequence
from concurrent.futures import Future
from typing import Any

from woosh_robot_agent.actions.actions import Actions
from woosh_robot_agent.bridge import LinkThread, LoopThread, outcome
from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.link import ChassisClient, LinkError
from woosh_robot_agent.link.timeouts import run_with_timeout
from woosh_robot_agent.logs import context_of, expect_losses, log_to_ros
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.parameter_node import ParameterNode
from woosh_robot_agent.parameters import Settings
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.services import Services
from woosh_robot_agent.standard.layer import StandardLayer
from woosh_robot_agent.standard.part_context import PartContext
from woosh_robot_agent.topics import Topics

_LOG = logging.getLogger(__name__)
_ZERO_TIMEOUT = 0.4
"""Time in which the chassis must answer the last zero velocity, in seconds."""
_GOALS_TIMEOUT = 0.5
"""Time in which the open goals must be aborted, in seconds."""
_LINK_TIMEOUT = 1.5
"""Time in which the link must be closed, in seconds."""
_CLOSE_TIMEOUT = 2 * _ZERO_TIMEOUT + _GOALS_TIMEOUT + _LINK_TIMEOUT
"""Time in which all of that must have ended, in seconds."""
_SETTLE_TIMEOUT = 0.5
"""Time in which the results of aborted goals must reach their clients, in seconds."""
_REST_TIMEOUT = 0.3
"""Time in which the remaining work must end, in seconds."""


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
        requests = RequestMaker(self.settings.link.robot_id)
        self._requests = requests
        self._topics = Topics(self.node, self._chassis)  # first: what it cannot read, nobody gets
        self._gate = MotionGate(self._chassis, lambda: self._actions.running_goals)
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
                lambda: self.settings.standard,
            )
        )
        self._lock = threading.Lock()
        self._end: Future[None] | None = None
        self.node.on_change(self._change)
        self._thread.call(self._chassis.start)
        self._standard.start()

    @property
    def settings(self) -> Settings:
        """The parameters' values of the moment."""
        return self.node.settings

    def begin_close(self) -> None:
        """Begin to stop the robot, to abort the open goals and to close the link. From any thread.

        Further calls do nothing. `close` waits for the end.
        """
        with self._lock:
            if self._end is None:
                expect_losses(self.node.get_logger(), expected=True)
                self._end = self._thread.begin(self._close())

    def close(self, spin_once: Callable[[], None]) -> None:
        """Stop the robot if the agent drove it, abort the open goals, close the link, clean up.

        Args:
            spin_once: runs the executor for a moment, so that results reach their clients.
        """
        close_all([self], spin_once)

    async def _close(self) -> None:
        # each step in any case; the gate's own timeout comes first, as its error says more
        await self._end_step("the stop of the robot", self._stop_robot, 2 * _ZERO_TIMEOUT)
        await self._end_step("the end of the goals", self._actions.stop, _GOALS_TIMEOUT)
        await self._end_step("the end of the link", self._chassis.close, _LINK_TIMEOUT)

    async def _stop_robot(self) -> None:
        try:
            await self._gate.close(_ZERO_TIMEOUT)
        except LinkError as error:
            _LOG.error(
                "the robot was not stopped; if it moves, press its emergency stop: %s", error
            )

    @staticmethod
    async def _end_step(
        name: str, work: Callable[[], Coroutine[Any, Any, None]], timeout: float
    ) -> None:
        try:
            await run_with_timeout(timeout, work())
        except TimeoutError:
            _LOG.error("%s took longer than %g s", name, timeout)
        except Exception:  # a defect of the agent, which must not keep the next step from running
            _LOG.exception("%s failed", name)

    def _change(self, before: Settings) -> None:
        self._requests.robot_id = self.settings.link.robot_id
        if self.settings.link != before.link:
            config = self.settings.link
            self._thread.spawn(lambda: self._chassis.reconfigure(config))


def close_all(agents: Sequence[Agent], spin_once: Callable[[], None]) -> None:
    """Close several agents at the same time; see `Agent.close`."""
    for agent in agents:
        agent.begin_close()
    ends = [agent._end for agent in agents if agent._end is not None]
    _spin_while(lambda: not all(end.done() for end in ends), spin_once, _CLOSE_TIMEOUT)
    _spin_while(
        lambda: any(agent._actions.open_goals for agent in agents), spin_once, _SETTLE_TIMEOUT
    )
    rests = [(agent, agent._thread.begin(agent._thread.cancel())) for agent in agents]
    until = time.monotonic() + _REST_TIMEOUT
    for agent, rest in rests:
        try:
            outcome(rest, max(until - time.monotonic(), 0.0))
        except TimeoutError:
            agent.node.get_logger().error("the agent's tasks did not end in time")
    for agent in agents:
        if agent._own_thread is not None:
            agent._own_thread.stop(_REST_TIMEOUT)
        if agent.node.executor is not None:  # it would keep what the node consists of
            agent.node.executor.remove_node(agent.node)
        expect_losses(agent.node.get_logger(), expected=False)
        agent._actions.destroy()
        agent.node.destroy_node()


def _spin_while(
    condition: Callable[[], bool], spin_once: Callable[[], None], timeout: float
) -> None:
    until = time.monotonic() + timeout
    while condition() and time.monotonic() < until:
        spin_once()
