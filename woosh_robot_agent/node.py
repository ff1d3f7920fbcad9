"""The agent's node: puts the link, the services, the topics and the actions together."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Coroutine
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from woosh_robot_agent.actions.actions import Actions
from woosh_robot_agent.bridge import LinkThread
from woosh_robot_agent.known import LastKnown
from woosh_robot_agent.link import ChassisClient, LinkError
from woosh_robot_agent.logs import RosLogHandler
from woosh_robot_agent.parameters import PARAMETERS, Settings, check
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.services import Services
from woosh_robot_agent.standard.host import Host
from woosh_robot_agent.standard.layer import StandardLayer
from woosh_robot_agent.topics import Topics

_STOP_TIMEOUT = 0.4
"""s that the robot gets to answer the last stop."""
_SETTLE_TIMEOUT = 0.5
"""s in which the results of aborted goals must be out."""
_CLOSE_TIMEOUT = 2.0
"""s after which the link is cut at the latest."""


class Agent:
    """The agent: a node, and behind it the link to the chassis in a thread of its own.

    Attributes:
        node: the node, to be added to an executor.

    Args:
        options: rclpy's options of a node, e.g. `context` and `parameter_overrides`.

    Raises:
        ValueError: a parameter makes no sense.
    """

    def __init__(self, **options: Any) -> None:
        self.node = Node("agent", **options)
        try:
            self.settings = self._declare()
        except BaseException:
            self.node.destroy_node()
            raise
        self._log_handler = RosLogHandler(self.node.get_logger())
        self._link_logger = logging.getLogger("woosh_robot_agent")
        self._link_logger.addHandler(self._log_handler)
        self._link_logger.setLevel(logging.DEBUG)
        self._link_logger.propagate = False
        self._thread = LinkThread()
        self._chassis = ChassisClient(config=self.settings.link)
        requests = RequestMaker(self.settings.link.robot_id)
        self._requests = requests
        self._topics = Topics(self.node, self._chassis)  # first: what it cannot read, nobody gets
        known = LastKnown(self._chassis)
        self._services = Services(self.node, self._thread, self._chassis, known, requests)
        self._actions = Actions(
            self.node,
            self._thread,
            self._chassis,
            known,
            requests,
            lambda: self.settings.goal_link_timeout,
            self.settings.result_timeout,
        )
        self._standard = StandardLayer(
            Host(
                self.node,
                self._thread,
                self._chassis,
                known,
                requests,
                self._actions,
                lambda: self.settings.standard,
            )
        )
        self.node.add_on_set_parameters_callback(self._check_change)
        self.node.add_post_set_parameters_callback(self._change)
        self._thread.call(self._chassis.start)
        self._standard.start()

    def close(self, spin_once: Callable[[], None]) -> None:
        """Stop the robot if the agent drove it, abort the open goals, and end the link.

        Args:
            spin_once: runs the executor for a moment, so that results reach their clients.
        """
        deadline = time.monotonic() + _CLOSE_TIMEOUT
        confirmed = self._stop_driving()
        self._bounded("end of the goals", self._actions.stop(), _SETTLE_TIMEOUT)
        settled = time.monotonic() + _SETTLE_TIMEOUT
        while self._actions.open_goals and time.monotonic() < settled:
            spin_once()
        if confirmed:  # another velocity may have come meanwhile
            self._stop_driving()
        self._bounded(
            "end of the link", self._chassis.close(), max(deadline - time.monotonic(), 0.1)
        )
        self._thread.stop(0.3)
        self._link_logger.removeHandler(self._log_handler)
        if self.node.executor is not None:  # it would keep what the node consists of
            self.node.executor.remove_node(self.node)
        self._actions.destroy()
        self.node.destroy_node()

    def _stop_driving(self) -> bool:
        stop = self._chassis.stop_driving(_STOP_TIMEOUT)
        return self._bounded("stop of the robot", stop, 2 * _STOP_TIMEOUT)

    def _bounded(self, what: str, work: Coroutine[Any, Any, None], timeout: float) -> bool:
        """Take one step of the end; whether it succeeded. The next ones come in any case."""
        try:
            self._thread.run(work, timeout)
        except (LinkError, TimeoutError) as error:
            self.node.get_logger().error(f"{what}: {error or 'it took too long'}")
            return False
        return True

    def _declare(self) -> Settings:
        for parameter in PARAMETERS:
            self.node.declare_parameter(parameter.name, parameter.initial, parameter.descriptor())
        return check({p.name: self.node.get_parameter(p.name).value for p in PARAMETERS})

    def _values_with(self, changed: list[Parameter]) -> dict[str, Any]:
        values = {p.name: self.node.get_parameter(p.name).value for p in PARAMETERS}
        values.update((p.name, p.value) for p in changed if p.name in values)
        return values

    def _check_change(self, changed: list[Parameter]) -> SetParametersResult:
        try:
            check(self._values_with(changed))
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _change(self, changed: list[Parameter]) -> None:
        before, self.settings = self.settings, check(self._values_with(changed))
        self._requests.robot_id = self.settings.link.robot_id
        if self.settings.link != before.link:
            config = self.settings.link
            self._thread.spawn(lambda: self._chassis.reconfigure(config))
