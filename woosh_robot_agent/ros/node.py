"""The agent of one robot: a ROS node with its parameters, services, topics and actions."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Coroutine, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import fields, replace
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.endpoints import minimum_timeouts
from woosh_robot_agent.link import ChassisClient, LinkConfig, LinkError
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.motion.requests import only_reads
from woosh_robot_agent.parameters import PARAMETERS, Parameter, Settings, check_names, settings_from
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.robot.refusals import RefusalExplainer
from woosh_robot_agent.robot.watch import Watch
from woosh_robot_agent.ros.actions.actions import Actions
from woosh_robot_agent.ros.bridge import LinkThread, LoopThread, wait_for_result
from woosh_robot_agent.ros.logs import context_of, log_as, log_to_ros, set_closing
from woosh_robot_agent.ros.rclpy_private import parameter_overrides
from woosh_robot_agent.ros.releases import on_parameters_set
from woosh_robot_agent.ros.second_agent import SecondAgentDetector
from woosh_robot_agent.ros.services import create_services
from woosh_robot_agent.ros.standard.layer import StandardLayer
from woosh_robot_agent.ros.standard.part import PartContext
from woosh_robot_agent.ros.topics import Topics

if TYPE_CHECKING:
    from woosh_robot_agent.ros.nav2.layer import Nav2Layer


class ParameterNode(Node):
    """The node `agent`, with its parameters declared and checked.

    Args:
        defaults: defaults by parameter name; they override the defaults in `PARAMETERS`.
        options: rclpy's options of a node, e.g. `context` and `parameter_overrides`.

    Attributes:
        settings: current values of the parameters.

    Raises:
        ValueError: a parameter is invalid.
    """

    def __init__(self, defaults: Mapping[str, Any] | None = None, **options: Any) -> None:
        super().__init__("agent", **options)
        try:
            for warning in check_names(parameter_overrides(self)):
                self.get_logger().warning(warning)
            for each in PARAMETERS:
                initial = (defaults or {}).get(each.name, each.initial)
                self.declare_parameter(each.name, initial, each.descriptor())
            self.settings = settings_from(self._values())
        except BaseException:
            self.destroy_node()
            raise

    def on_change(self, callback: Callable[[Settings], None]) -> None:
        """Check and apply changes of parameters from now on.

        Args:
            callback: called after each change with the previous settings.
        """

        def apply(changed: list[RosParameter]) -> None:
            before, self.settings = self.settings, settings_from(self._values(changed))
            callback(before)

        on_parameters_set(self, self._check_change, apply)

    def _values(self, changed: Sequence[RosParameter] = ()) -> dict[str, Any]:
        """Return the current values by name, with the changed ones in their place."""
        values = {p.name: self._value(p) for p in PARAMETERS}
        values.update((p.name, p.value) for p in changed if p.name in values)
        return values

    def _value(self, parameter: Parameter) -> Any:
        if parameter.holds_names:  # an empty list in a file has no type, so rclpy leaves it unset
            return self.get_parameter_or(parameter.name).value or []
        return self.get_parameter(parameter.name).value

    def _check_change(self, changed: list[RosParameter]) -> SetParametersResult:
        log_as(self.get_logger())  # the thread also runs the callbacks of other robots' nodes
        try:
            settings_from(self._values(changed))
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


_LOG = logging.getLogger(__name__)
_ZERO_TIMEOUT = 0.4
"""Time in which the chassis must answer the last zero velocity, in seconds."""
_GOALS_TIMEOUT = 0.5
"""Time in which the open goals must be aborted, in seconds."""
_LINK_TIMEOUT = 1.5
"""Time in which the link must be closed, in seconds."""
_CLOSE_TIMEOUT = 2 * _ZERO_TIMEOUT + _GOALS_TIMEOUT + _LINK_TIMEOUT
"""Time in which the robot, the goals and the link must be stopped together, in seconds."""
_DEBUG_TIMEOUT = 60.0
"""Time that a busy link thread gets to answer `Agent.debug`, in seconds."""
_REST_TIMEOUT = 0.3
"""Time in which the remaining tasks must end, in seconds."""


class Agent:
    """The agent of one robot: a ROS node, and the link to the chassis in another thread.

    Attributes:
        node: the node, to be added to an executor.
        robot: the link, the motion gate and the other objects of `PartContext`.
        actions: the action servers, with their goals.

    Args:
        node: the node.
        thread: thread of the link. Stop it after closing the agent.
        link: values for fields of `LinkConfig` that are no parameters, e.g. `backoff_min`.
    """

    def __init__(
        self, node: ParameterNode, thread: LoopThread, link: Mapping[str, Any] | None = None
    ) -> None:
        self.node = node
        log_to_ros()
        link_thread = LinkThread(thread, context_of(node.get_logger()))
        self._link_fields = dict(link or {})
        chassis = ChassisClient(config=self._link_config(), minimum_timeouts=minimum_timeouts())
        # the first consumer: it reads each push, so that no other one gets an unreadable push
        self._topics = Topics(self.node, link_thread, chassis)
        # here and below, functions stand for `self.actions`, which is created later
        gate = MotionGate(chassis, self._running_goals)
        last_known = LastKnown(chassis)
        explainer = RefusalExplainer(chassis, last_known)
        watch = Watch(chassis, gate, last_known, explainer, lambda: self.actions.accepted_goals)
        requests = RequestMaker(self.settings.link.robot_id)
        self.robot = PartContext(
            self.node,
            link_thread,
            chassis,
            gate,
            last_known,
            requests,
            watch,
            SecondAgentDetector(self.node),
            lambda: self.settings.standard,
            lambda command, **options: self.actions.start(command, **options),
        )
        create_services(self.robot, watch, lambda: self.settings.standard.velocity_limits)
        self.actions = Actions(
            self.robot,
            explainer.reason,
            lambda: self.settings.goal_link_timeout,
            self.settings.result_timeout,
        )
        self._standard = StandardLayer(self.robot)
        self._nav2 = self._create_nav2() if self.settings.nav2 else None
        self._lock = threading.Lock()
        """Protects `_stopped`: `begin_close` may be called from several threads at once."""
        self._stopped: Future[None] | None = None
        """Done when the robot, the goals and the link are stopped; None until `begin_close`."""
        self.node.on_change(self._settings_changed)
        if self.settings.observe_only:
            chassis.permit_only(only_reads, self._observe_only_reason)
        link_thread.call(chassis.start)
        self._standard.start()
        link_thread.spawn(self.robot.second_agent_detector.run)
        if self._nav2 is not None:
            self._nav2.start()

    def _create_nav2(self) -> Nav2Layer | None:
        """Create Nav2's interfaces; None if their definitions are not installed."""
        if find_spec("nav2_msgs") is None:
            self.node.get_logger().error(
                "nav2 is true, but there are no actions of Nav2, because nav2_msgs is not "
                "installed: apt install ros-$ROS_DISTRO-nav2-msgs"
            )
            return None
        # imported here, because without nav2 its modules and interfaces need not be loaded
        from woosh_robot_agent.ros.nav2.layer import Nav2Layer

        return Nav2Layer(
            self.robot,
            self.actions,
            lambda: self._standard.map_to_odom,
            self.settings.result_timeout,
        )

    def _running_goals(self) -> int:
        """Return the number of goals that may drive the robot, even if it is between two parts."""
        return self.actions.running_goals + (self._nav2.driving_goals if self._nav2 else 0)

    @property
    def settings(self) -> Settings:
        """Current values of the parameters."""
        return self.node.settings

    def debug(self) -> dict[str, Any]:
        """Return the state of the agent, the sizes of its queues, and its counters.

        For debugging and for tests: keys may be added at any time. May be called from any thread
        except the link thread.

        Returns:
            `state`: The state of the link.
            `requests`: Number of requests in flight.
            `outbox`: Number of frames that wait to be sent.
            `pushes`: Number of pushes and answers that wait to be delivered.
            `counters`: The link's counters, by the names of the attributes of `LinkStats`.
            `goals`: Number of goals of action servers that have not ended.
            `running_goals`: Number of goals that the robot may be working on.
            `tasks`: Names of the asyncio tasks in the link thread.

        Raises:
            TimeoutError: the link thread did not answer in time.
        """
        return self.robot.thread.run(self._debug(), _DEBUG_TIMEOUT)

    async def _debug(self) -> dict[str, Any]:
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        stats = self.robot.chassis.stats
        return {
            **self.robot.chassis.debug(),
            "state": self.robot.chassis.state.value,
            "counters": {each.name: getattr(stats, each.name) for each in fields(stats)},
            "goals": self.actions.open_goals + (self._nav2.open_goals if self._nav2 else 0),
            "running_goals": self.actions.running_goals,
            "tasks": sorted(task.get_name() for task in tasks),
        }

    def begin_close(self) -> None:
        """Begin to stop the robot, to abort the open goals and to close the link. From any thread.

        Further calls do nothing. `stop_all` waits for the end.
        """
        with self._lock:
            if self._stopped is None:
                set_closing(self.node.get_logger(), closing=True)
                self._stopped = self.robot.thread.begin(self._close())

    def destroy(self) -> None:
        """Destroy the node, after `stop_all`."""
        self.node.destroy_node()

    async def _close(self) -> None:
        # each step runs, even if the one before failed; the first step gets twice the timeout of
        # `gate.close`, so that `gate.close` times out first: its error says more
        await self._close_step("stopping the robot", self._stop_robot, 2 * _ZERO_TIMEOUT)
        await self._close_step("aborting the goals", self._abort_goals, _GOALS_TIMEOUT)
        await self._close_step("closing the link", self.robot.chassis.close, _LINK_TIMEOUT)

    async def _abort_goals(self) -> None:
        await self.actions.stop()
        if self._nav2 is not None:
            await self._nav2.stop()

    async def _stop_robot(self) -> None:
        try:
            await self.robot.gate.close(_ZERO_TIMEOUT)
        except LinkError as error:
            _LOG.error(
                "the robot was not stopped; if it moves, press its emergency stop: %s", error
            )

    @staticmethod
    async def _close_step(
        name: str, work: Callable[[], Coroutine[Any, Any, None]], timeout: float
    ) -> None:
        try:
            await run_with_timeout(timeout, work())
        except TimeoutError:
            _LOG.error("%s took longer than %g s", name, timeout)
        except Exception:  # a defect of the agent, which must not keep the next step from running
            _LOG.exception("%s failed", name)

    @property
    def _observe_only_reason(self) -> str:
        """Why commands are refused while `observe_only` is true, and how to allow them."""
        name = self.node.get_fully_qualified_name()
        return (
            "this agent only observes the robot; to allow commands, call "
            f"`ros2 param set {name} observe_only false`"
        )

    def _settings_changed(self, before: Settings) -> None:
        settings = self.settings
        if settings.observe_only != before.observe_only:
            # `call`, not `spawn`: a task might begin only after commands that follow this change
            self.robot.thread.call(self._set_observe_only, settings.observe_only)
        if settings.link != before.link:
            self.robot.thread.spawn(self._reconfigure)
        if self._nav2 is not None:
            self.robot.thread.call(self._nav2.speed_limit.settings_changed)

    def _link_config(self) -> LinkConfig:
        return replace(self.settings.link, **self._link_fields)

    def _set_observe_only(self, observe_only: bool) -> None:
        if not observe_only:
            self.robot.chassis.permit_only(None)
            _LOG.info("observe_only is false: commands are sent to the robot")
            return
        reason = self._observe_only_reason
        self.robot.chassis.permit_only(only_reads, reason)
        self.actions.give_up(f"{reason}; the robot may still be executing the goal")
        _LOG.info("observe_only is true: nothing is sent to the robot that changes or moves it")
        # sends a zero if the agent drives the robot, although commands are not permitted now
        self.robot.thread.spawn(partial(self.robot.gate.stop_driving, reason, _ZERO_TIMEOUT))

    async def _reconfigure(self) -> None:
        """Apply new settings of the link; if they need a new connection, stop the robot first."""
        self.robot.requests.robot_id = self.settings.link.robot_id
        if not self._link_config().keeps_connection(self.robot.chassis.config):
            await self.robot.gate.stop_driving(
                "the settings of the link have changed", _ZERO_TIMEOUT
            )
        # read again: the settings may have changed once more meanwhile
        await self.robot.chassis.reconfigure(self._link_config())


def stop_all(agents: Sequence[Agent], spin_once: Callable[[], None]) -> None:
    """Stop the robots that the agents drive, abort the goals and close the links; keep the nodes.

    Args:
        agents: agents of one executor.
        spin_once: runs one turn of this executor, so that goal results reach their clients.
    """
    for agent in agents:
        agent.begin_close()
    stopped = [agent._stopped for agent in agents if agent._stopped is not None]
    until = time.monotonic() + _CLOSE_TIMEOUT
    while time.monotonic() < until and not all(each.done() for each in stopped):
        spin_once()
    cancels = [(agent, agent.robot.thread.begin(agent.robot.thread.cancel())) for agent in agents]
    until = time.monotonic() + _REST_TIMEOUT
    for agent, cancelled in cancels:
        try:
            wait_for_result(cancelled, max(until - time.monotonic(), 0.0))
        except TimeoutError:
            agent.node.get_logger().error("the agent's tasks did not end in time")
    for agent in agents:
        if agent.node.executor is not None:  # an executor keeps the entities of its nodes alive
            agent.node.executor.remove_node(agent.node)
        set_closing(agent.node.get_logger(), closing=False)
