"""Building blocks of the tests with ROS: the real agent, and a ROS client that uses it.

The agent talks to a simulated chassis over a socket, and to the client over DDS, in a ROS domain
that no other test uses.
"""

from __future__ import annotations

import asyncio
import os
import signal
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import COMMANDS, QUERIES, TOPICS
from woosh_robot_agent.link import ChassisClient, LinkState
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.ros.actions.goal import GoalTiming
from woosh_robot_agent.ros.releases import this_computer_only
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import TIMEOUT, AgentProcess, Spinner, own_domain, wait_until
from woosh_robot_agent.testing import AgentInProcess as RunningAgent
from woosh_robot_agent.testing.agents import NAMESPACE

__all__ = [
    "HUMBLE",
    "NAMESPACE",
    "TIMEOUT",
    "Client",
    "Collector",
    "GoalClient",
    "Logs",
    "Program",
    "Robot",
    "RunningAgent",
    "Spinner",
    "fill",
    "own_domain",
    "wait_future",
    "wait_until",
]

HUMBLE = os.environ.get("ROS_DISTRO") == "humble"
"""True on ROS 2 Humble, which lacks some of what the agent uses; see `ros_release`."""

for _name, _value in this_computer_only().items():
    os.environ.setdefault(_name, _value)


class Collector:
    """Messages received on a topic, oldest first."""

    def __init__(self) -> None:
        self.messages: list[Any] = []
        self._changed = threading.Condition()

    def add(self, message: Any) -> None:
        with self._changed:
            self.messages.append(message)
            self._changed.notify_all()

    def wait(self, wanted: Callable[[Any], Any], timeout: float = TIMEOUT) -> Any:
        """Wait for a message for which `wanted` is true; return the first one."""
        with self._changed:
            found = self._changed.wait_for(lambda: [m for m in self.messages if wanted(m)], timeout)
        assert found, f"no such message among {self.messages}"
        return found[0]

    def wait_count(self, count: int) -> list[Any]:
        """Wait until this many messages have been received; return all."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.messages) >= count, TIMEOUT), (
                f"{len(self.messages)} of {count} messages received: {self.messages}"
            )
            return list(self.messages)


class Logs(Collector):
    """Log records, oldest first."""

    def wait_text(self, *texts: str, level: str = "") -> Any:
        """Wait for a record with all these texts, and with the level if one is given; return it."""
        return self.wait(
            lambda record: (
                all(text in record.getMessage() for text in texts)
                and level in ("", record.levelname)
            )
        )

    def with_text(self, text: str, level: str = "") -> list[Any]:
        """Return the records with a text, and with the level if one is given."""
        return [
            record
            for record in list(self.messages)
            if text in record.getMessage() and level in ("", record.levelname)
        ]


class _Callbacks(dict[bytes, Any]):
    """Feedback callbacks by goal id that stay registered after the result.

    rclpy removes a goal's callback with its result. When both feedback and the result are ready, it
    reads the result first, and would drop the feedback.
    """

    def __delitem__(self, goal: bytes) -> None:
        pass


class GoalClient:
    """An accepted goal, from the client's side."""

    def __init__(self, client: Client, action: ActionClient, goal: Any) -> None:
        self.feedback = Collector()
        self._client = client
        sent = client.in_executor(
            lambda: action.send_goal_async(
                goal, feedback_callback=lambda message: self.feedback.add(message.feedback.fb)
            )
        )
        self.handle = wait_future(sent)
        assert self.handle.accepted
        self._result = self.ask_result()

    def result(self, timeout: float = TIMEOUT) -> tuple[int, Any]:
        """Wait for the result; return its status (action_msgs/GoalStatus) and `ret`."""
        response = wait_future(self._result, timeout)
        return response.status, response.result.ret

    def wait_aborted(self, *texts: str) -> Any:
        """Wait until the goal is aborted, with these texts in its message; return `ret`."""
        status, ret = self.result()
        assert status == GoalStatus.STATUS_ABORTED, ret
        for text in texts:
            assert text in ret.msg
        return ret

    @property
    def done(self) -> bool:
        """True if the result has been received."""
        return bool(self._result.done())

    def ask_result(self) -> Any:
        """Request the result; return the future of the response."""
        return self._client.in_executor(self.handle.get_result_async)

    def cancel(self) -> Any:
        """Request a cancel; return the action_msgs/CancelGoal response."""
        return wait_future(self._client.in_executor(self.handle.cancel_goal_async))


def wait_future(future: Any, timeout: float = TIMEOUT) -> Any:
    """Wait for an rclpy future, which another thread's executor completes; return its result."""
    done = threading.Event()
    future.add_done_callback(lambda _future: done.set())
    assert done.wait(timeout), "no answer received"
    return future.result()


_SERVICES = {each.name: each.srv for each in (*QUERIES, *COMMANDS)}
"""ROS types of the services in the table of endpoints, by their names."""


def fill(message: Any, **values: Any) -> Any:
    """Set fields of a message, and return it.

    Args:
        message: the message.
        values: value of each field by its name: a dict for a message, and a number for an enum,
            which in ROS is a message with the field `value`.
    """
    for name, value in values.items():
        field = getattr(message, name)
        if isinstance(value, dict):
            fill(field, **value)
        elif hasattr(field, "value"):
            field.value = value
        else:
            setattr(message, name, value)
    return message


class Client:
    """A ROS node that uses the agent, with its own context and executor thread."""

    def __init__(self, domain: int, namespace: str = NAMESPACE, name: str = "client") -> None:
        self.namespace = namespace
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node(name, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._spinner = Spinner(self.executor)
        self._clients: dict[Any, Any] = {}
        """Clients by type and name; a service and an action may share a name."""
        self._known_by: dict[Any, set[bytes]] = {}
        """The agent that has discovered a client."""
        self._lock = threading.Lock()
        """Held while an action client is created, so that each action gets one only."""

    def close(self) -> None:
        self._spinner.stop()
        for client in self._clients.values():
            if isinstance(client, ActionClient):  # `destroy_node` leaves it, and so the node
                client.destroy()
        self.node.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown(context=self.context)

    def in_executor(self, function: Callable[[], Any]) -> Any:
        """Run `function` in the executor's thread and return its result.

        Create action clients in that thread: Kilted's rclpy adds a client to the node before the
        client is complete. Also send from it: rclpy registers a request only after sending it, so
        in any other thread the answer may be read first, and is then dropped.
        """
        return wait_future(self.executor.create_task(function))

    def unsubscribe(self, subscription: Any) -> None:
        """Remove a subscription in the executor's thread, because the executor may be using it."""
        self.in_executor(lambda: self.node.destroy_subscription(subscription))

    def path(self, name: str) -> str:
        """Return a name in the agent's namespace, unless it is absolute."""
        return name if name.startswith("/") else f"{self.namespace}/{name}"

    def service(self, srv: Any, name: str) -> Any:
        """Return the client of a service, once both ends have discovered each other."""
        if (srv, name) not in self._clients:
            # as deep as the agent's: with the default depth of 10, answers of a burst are lost
            self._clients[srv, name] = self.node.create_client(
                srv, self.path(name), qos_profile=QoSProfile(depth=1000)
            )
        client = self._clients[srv, name]
        agent = self._agent()
        if not self._is_known(client, agent):
            # wait_for_service polls only every 0.25 s
            wait_until(client.service_is_ready, f"the service {name}")
            parameters = self.path("agent/get_parameters")
            if parameters in dict(self.node.get_service_names_and_types()):
                self.wait_known(GetParameters, parameters)
            self._known_by[client] = agent
        return client

    def _agent(self) -> set[bytes]:
        """Return what tells the agent of this namespace from one that ran before."""
        publishers = self.node.get_publishers_info_by_topic(self.path(TOPICS[0].name))
        return {bytes(publisher.endpoint_gid) for publisher in publishers}

    def _is_known(self, client: Any, agent: set[bytes]) -> bool:
        """Return True if an agent has discovered a client, or has ended."""
        known = self._known_by.get(client)
        return known is not None and agent <= known

    def wait_known(self, srv: Any, path: str) -> None:
        """Wait until the agent has discovered all endpoints that this node has created so far.

        A service is ready when this node has discovered the agent's end. If the agent has not yet
        discovered this node's end, it drops its answer after 0.1 s. DDS announces endpoints in the
        order of their creation, so an answer to a newly created client proves that the agent has
        discovered all earlier ones. The request must have no effect.

        Args:
            srv: the type of a service of the agent.
            path: its name.
        """
        probe = self.node.create_client(srv, path)
        wait_until(probe.service_is_ready, path)

        def answered() -> bool:
            done = threading.Event()
            probe.call_async(srv.Request()).add_done_callback(lambda _: done.set())
            return done.wait(1.0)

        wait_until(answered, f"an answer from {path}")
        self.in_executor(lambda: self.node.destroy_client(probe))

    def call(self, srv: Any, name: str, timeout: float = TIMEOUT, **fields: Any) -> Any:
        """Call a service; return its response.

        The call is repeated if a busy machine has just held up the agent, which then moves nothing.
        """
        while True:
            response = wait_future(self.call_async(srv, name, **fields), timeout)
            if "the agent stood still" not in getattr(response, "msg", ""):
                return response

    def command(self, name: str, /, **values: Any) -> Any:
        """Call a service in the table of endpoints; return its response.

        Args:
            name: name of the service.
            values: fields of its argument, as for `fill`.
        """
        srv = class_of(_SERVICES[name], "srv")
        return self.call(srv, name, arg=fill(srv.Request().arg, **values))

    def call_async(self, srv: Any, name: str, **fields: Any) -> Any:
        """Call a service; return the future of its response."""
        return self.service(srv, name).call_async(srv.Request(**fields))

    def echo(self, msg: Any, name: str, depth: int = 100) -> Collector:
        """Subscribe to a latched topic."""
        qos = QoSProfile(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
        return self.echo_with(msg, name, qos)

    def echo_with(self, msg: Any, name: str, qos: QoSProfile) -> Collector:
        """Subscribe with the given quality of service."""
        collector = Collector()
        self.node.create_subscription(msg, self.path(name), collector.add, qos)
        return collector

    def publisher(self, msg: Any, name: str, depth: int = 10) -> Any:
        """Create a publisher; return it once it has discovered a subscriber."""
        publisher = self.node.create_publisher(msg, self.path(name), depth)
        wait_until(publisher.get_subscription_count, f"a subscriber of {name}")
        return publisher

    def publishers(self, name: str) -> int:
        """Return the number of publishers of a topic."""
        return int(self.node.count_publishers(self.path(name)))

    def action(self, action: Any, name: str) -> ActionClient:
        """Return the client of an action, once both ends have discovered each other."""
        with self._lock:
            if (action, name) not in self._clients:
                client = self.in_executor(
                    lambda: ActionClient(
                        self.node,
                        action,
                        self.path(name),
                        # with the default depth of 10, feedback is lost when this process is slow
                        feedback_sub_qos_profile=QoSProfile(depth=1000),
                    )
                )
                client._feedback_callbacks = _Callbacks()
                self._clients[action, name] = client
            client = self._clients[action, name]
            agent = self._agent()
            if not self._is_known(client, agent):
                self.wait_known(
                    action.Impl.GetResultService, f"{self.path(name)}/_action/get_result"
                )
                wait_until(client.server_is_ready, f"the action {name}")
                self._known_by[client] = agent
        return client

    def send_goal(self, action: Any, name: str, goal: Any) -> GoalClient:
        """Send a goal; return it once it has been accepted."""
        return GoalClient(self, self.action(action, name), goal)


class Robot(Client):
    """A client of an agent, with the agent and the simulated chassis that it is connected to.

    Attributes:
        agent: the agent.
        chassis: the chassis.
    """

    def __init__(self, agent: RunningAgent, chassis: SimulatorThread) -> None:
        super().__init__(agent.domain, agent.namespace)
        self.agent = agent
        self.chassis = chassis
        self._motion_timing = self.gate.timing
        self._own = set(self._endpoints)
        """Topics of this node that no test has created."""

    @property
    def link(self) -> ChassisClient:
        """The agent's link to the chassis."""
        return self.agent.agent.robot.chassis

    @property
    def gate(self) -> MotionGate:
        """The agent's motion gate."""
        return self.agent.agent.robot.gate

    def set_goal_timing(self, **changes: float) -> None:
        """Change the `GoalTiming` of goals that start after this call."""
        actions = self.agent.agent.actions
        actions.timing = replace(actions.timing, **changes)

    def set_motion_timing(self, **changes: float) -> None:
        """Change the `MotionTiming` of the agent."""
        self.gate.timing = replace(self.gate.timing, **changes)

    def use(self, chassis: SimulatorThread) -> None:
        """Connect the agent to a chassis, for the next test of those that share the agent."""
        self.chassis = chassis
        port = Parameter("port", value=chassis.port).to_parameter_msg()
        answer = self.call(SetParameters, "agent/set_parameters", parameters=[port])
        assert answer.results[0].successful, answer.results[0].reason
        wait_until(
            lambda: self.link.config.port == chassis.port and self.link.state is LinkState.READY,
            "the link",
        )

    @property
    def _endpoints(self) -> list[Any]:
        return [*self.node.subscriptions, *self.node.publishers]

    def forget(self) -> None:
        """End all goals, and let the agent and this client forget the test and its chassis."""
        actions = self.agent.agent.actions

        async def give_up() -> None:
            actions.give_up("the test has ended")
            while actions.running_goals:
                await asyncio.sleep(0.005)
            # reports on them must not be taken for reports on goals of the next test
            actions._last_feedback.clear()
            actions._last_reports.clear()

        self.agent.agent.robot.thread.run(give_up(), TIMEOUT)
        actions.timing = GoalTiming()
        self.gate.timing = self._motion_timing
        for each in set(self._endpoints) - self._own:
            is_publisher = each in list(self.node.publishers)
            destroy = (
                self.node.destroy_publisher if is_publisher else self.node.destroy_subscription
            )
            self.in_executor(partial(destroy, each))

    def wait_lost(self) -> None:
        """Wait until the agent has noticed that its link is lost."""
        wait_until(lambda: self.link.state is not LinkState.READY, "the loss of the link")


class Program(AgentProcess):
    """The agent's program."""

    def __init__(self, domain: int, *arguments: str, **parameters: Any) -> None:
        super().__init__(domain, NAMESPACE, *arguments, **parameters)

    def end(self, number: int = signal.SIGINT) -> None:
        """Send a signal and wait for a clean end."""
        self.process.send_signal(number)
        status = self.process.wait(TIMEOUT)
        self.wait_read()
        assert status == 0, self.output
        assert "Traceback" not in self.output, self.output
