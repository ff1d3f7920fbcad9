"""The monitor's view over ROS: what the agent publishes, and whether the agent is there."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Bool

from woosh_robot_agent.convert import BadFieldError, Converter, converter
from woosh_robot_agent.endpoints import ACTIONS, QUERIES, TOPICS
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.protos import full_name, message_type
from woosh_robot_agent.qos import latched
from woosh_robot_agent.ros_types import class_of
from woosh_robot_agent.tools.view import LinkReport, View

_LOOK_EVERY = 0.5
_STALE = 5.0
"""s without an answer of the agent after which what is shown may be old."""
_BEAT_PATIENCE = 2.0
"""s without the agent's parameters after which they are asked for again."""
_PATIENCE = 12.0
"""s without RobotInfo after which it is asked for again; the agent gives the robot 10 s."""
_SPIN = 0.1
_INFO = next(query for query in QUERIES if query.request == full_name(RobotInfo))
_WATCHED = TOPICS[0]
"""Topic by whose publisher the agent is found."""
_UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""What rmw calls a node whose publishers it has met before itself."""
_ADDRESS = ("transport", "ip", "port")


class _Question:
    """A service that is asked again when the answer does not come: DDS can lose the first one.

    Args:
        client: rclpy's client of it.
        request: what is asked.
        patience: s to wait for the answer.
        answered: gets the answer.
    """

    def __init__(
        self, client: Any, request: Any, patience: float, answered: Callable[[Any], None]
    ) -> None:
        self.client = client
        self._request = request
        self._patience = patience
        self._answered = answered
        self._future: Any = None
        self._asked = 0.0

    def ask(self) -> None:
        """Ask, unless an answer is under way or nobody is there to ask."""
        if self._future is not None:
            if time.monotonic() - self._asked < self._patience:
                return
            self.drop()
        if self.client.service_is_ready():
            self._asked = time.monotonic()
            self._future = self.client.call_async(self._request)
            self._future.add_done_callback(self._done)

    def drop(self) -> None:
        """Want no answer any more."""
        if self._future is not None:
            future, self._future = self._future, None
            self.client.remove_pending_request(future)

    def _done(self, future: Any) -> None:
        if future is self._future:  # else it was dropped
            self._future = None
            self._answered(future.result())


class RosSource:
    """Listens to one agent; its values are brought to the asyncio loop that started it.

    Args:
        namespace: of the agent; `--ros-args -r __ns:=` goes first.
        ros_args: arguments for rclpy.
        domain: ROS_DOMAIN_ID; None takes the environment's.

    Attributes:
        name: the agent's namespace.
        view: what the agent has published.

    Raises:
        Exception: rclpy's own, where namespace or arguments make no sense.
    """

    def __init__(
        self, namespace: str, ros_args: Sequence[str] = (), domain: int | None = None
    ) -> None:
        self.view = View()
        self._context = Context()
        rclpy.init(args=list(ros_args), context=self._context, domain_id=domain)
        try:
            self._node = Node(f"monitor_{os.getpid()}", namespace=namespace, context=self._context)
        except BaseException:
            rclpy.try_shutdown(context=self._context)
            raise
        self.name = self._node.get_namespace()
        self._agent: _Question | None = None
        """Asks for the agent's parameters, by which it shows that it lives."""
        self._agent_name = ""
        self._answered = 0.0
        self._address = ""
        self._connected: bool | None = None
        self._unreadable = (0, "")
        """How many messages could not be read, and what was wrong with the last one."""
        self._info: _Question
        self._wants_info = True
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="monitor", daemon=True)
        self._loop: asyncio.AbstractEventLoop

    async def start(self) -> None:
        """See `Source.start`."""
        self._loop = asyncio.get_running_loop()
        node = self._node
        for topic in TOPICS:
            self._listen(topic.name, class_of(topic.msg, "msg"), topic.push, latched(topic.depth))
        for action in ACTIONS:
            if action.member:  # the other one reports what the topic says, too
                self._follow(action.name, class_of(action.action, "action"), action.feedback)
        node.create_subscription(Bool, "connected", self._on_connected, latched(1))
        srv = class_of(_INFO.srv, "srv")
        client = node.create_client(srv, _INFO.name)
        self._info = _Question(client, srv.Request(), _PATIENCE, self._on_info)
        node.create_timer(_LOOK_EVERY, self._look)
        self._thread.start()

    async def close(self) -> None:
        """See `Source.close`."""
        self._stop.set()
        if self._thread.is_alive():
            await asyncio.get_running_loop().run_in_executor(None, self._thread.join)
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def link(self) -> LinkReport:
        """See `Source.link`."""
        agent, connected = self._agent, self._connected
        if agent is None:
            return LinkReport(
                False,
                f"no agent in {self.name}",
                "start it, or check --namespace and ROS_DOMAIN_ID",
            )
        silent = time.monotonic() - self._answered
        if silent > _STALE:
            return LinkReport(
                False,
                f"the agent has not answered for {silent:.0f} s"
                if self._answered
                else "the agent has not answered yet",
                "it hangs, was killed, or the network is gone",
            )
        where = self._address or "the chassis"
        if connected is False:
            return LinkReport(
                False, f"the agent has lost {where}", "its log and `doctor` say what is wrong"
            )
        count, why = self._unreadable
        bad = f"{count} messages could not be read, the last because of {why}" if count else ""
        if connected is None:
            return LinkReport(
                True,
                f"the agent answers; it does not say whether {where} does",
                bad or "start it with enable_connected true to see that",
            )
        return LinkReport(True, f"the agent answers, and is connected to {where}", bad)

    # In the executor's thread

    def _spin(self) -> None:
        executor = SingleThreadedExecutor(context=self._context)
        executor.add_node(self._node)
        try:
            while not self._stop.is_set():
                executor.spin_once(timeout_sec=_SPIN)
        except ExternalShutdownException:
            pass
        finally:
            executor.shutdown()

    def _take(self, convert: Converter, message: Any) -> None:
        try:
            readable = convert.to_proto(message)
        except BadFieldError as error:  # robots do report what is no number
            self._unreadable = self._unreadable[0] + 1, str(error)
            return
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self.view.take, readable)

    def _listen(self, name: str, ros_class: Any, push: str, qos: QoSProfile) -> None:
        convert = converter(ros_class, message_type(push))
        self._node.create_subscription(ros_class, name, partial(self._take, convert), qos)

    def _follow(self, name: str, action_class: Any, feedback: str) -> None:
        """Listen to what the action server tells those who sent the goals."""
        message_class = action_class.Impl.FeedbackMessage
        cls = type(message_class().feedback.fb)
        convert = converter(cls, message_type(feedback))
        self._node.create_subscription(
            message_class,
            f"{name}/_action/feedback",
            lambda message: self._take(convert, message.feedback.fb),
            QoSProfile(depth=10),
        )

    def _on_connected(self, message: Any) -> None:
        if message.data and self._connected is False:
            self._wants_info = True
        self._connected = message.data

    def _look(self) -> None:
        """See whether the agent is there, and ask for RobotInfo when it, or its robot, has come."""
        topic = self._node.resolve_topic_name(_WATCHED.name)
        found = {
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._node.get_publishers_info_by_topic(topic)
            if info.node_name != _UNKNOWN_NODE
        }
        if self._agent_name not in found:
            if self._agent is not None:  # else what `connected` says is of the agent to be met
                self._forget()
            if not found:
                return
            self._meet(min(found))
        assert self._agent is not None
        self._agent.ask()
        if self._wants_info:
            self._info.ask()

    def _meet(self, name: str) -> None:
        """There is an agent."""
        self._answered, self._wants_info = 0.0, True
        client = self._node.create_client(GetParameters, f"{name}/get_parameters")
        request = GetParameters.Request(names=list(_ADDRESS))
        self._agent = _Question(client, request, _BEAT_PATIENCE, self._on_parameters)
        self._agent_name = name

    def _forget(self) -> None:
        """The agent has gone."""
        assert self._agent is not None
        self._agent.drop()
        self._node.destroy_client(self._agent.client)
        self._info.drop()
        self._agent = self._connected = None
        self._agent_name = ""

    def _on_parameters(self, response: Any) -> None:
        self._answered = time.monotonic()
        transport, ip, port = response.values
        self._address = f"{ip.string_value}:{port.integer_value or ''}".rstrip(":")
        self._address += f" by {transport.string_value}"

    def _on_info(self, response: Any) -> None:
        self._wants_info = False
        self._take(converter(type(response.info), RobotInfo), response.info)
