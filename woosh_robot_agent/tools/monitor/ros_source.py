"""Receive the state of a robot from its agent, over ROS."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.qos import QoSProfile
from std_msgs.msg import Bool

from woosh_robot_agent.convert import BadFieldError, Converter, converter
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import ACTIONS, QUERIES, TOPICS
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.config import url_host
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.ros.qos import latched
from woosh_robot_agent.tools.options import link_arguments
from woosh_robot_agent.tools.robot_view import LinkReport, RobotView
from woosh_robot_agent.tools.ros_node import NodeThread, find_agents

_DISCOVERY_PERIOD = 0.5
"""Time between two searches for the agent, in seconds."""
_CONNECTED_TIMEOUT = 3.0
"""Time for which the first message on the agent's topic `connected` is awaited after the agent's
first answer, in seconds."""
_AGENT_TIMEOUT = 5.0
"""Time without an answer of the agent after which the view may be outdated, in seconds."""
_PARAMETERS_TIMEOUT = 2.0
"""Time without an answer after which the parameters are requested again, in seconds."""
_ROBOT_INFO_TIMEOUT = 12.0
"""Time without an answer after which RobotInfo is requested again, in seconds: longer than the
agent waits for the robot, which is 10 s."""
_ROBOT_INFO = next(query for query in QUERIES if query.request == full_name(RobotInfo))
_CONNECTED = "connected"
_PARAMETERS = ("transport", "ip", "port", "encoding", "robot_id")
"""Parameters requested from the agent, to show the address, and to see that it is alive."""


class _RepeatedCall:
    """Repeated call of a service, with at most one call in flight.

    Args:
        timeout: time after which a call without a response is given up, in seconds, because DDS
            can lose the first request.
        on_response: called with each response.
    """

    def __init__(
        self,
        node: Any,
        srv: Any,
        name: str,
        request: Any,
        timeout: float,
        on_response: Callable[[Any], None],
    ) -> None:
        self._node, self._srv, self._name = node, srv, name
        self._client: Any = node.create_client(srv, name)
        self._request = request
        self._timeout = timeout
        self._on_response = on_response
        self._future: Any = None
        """The call in flight; None without one."""
        self._called_at = 0.0
        """Time of the last call, in `time.monotonic` seconds."""

    def call(self) -> None:
        """Call the service if it is available, unless a call is in flight and not timed out."""
        if self._future is not None:
            if time.monotonic() - self._called_at < self._timeout:
                return
            # a new client, because Fast DDS sometimes never matches a client with a ready service
            self.close()
            self._client = self._node.create_client(self._srv, self._name)
        if self._client.service_is_ready():
            self._called_at = time.monotonic()
            self._future = self._client.call_async(self._request)
            self._future.add_done_callback(self._on_done)

    def cancel(self) -> None:
        """Give up the call in flight, if any."""
        if self._future is not None:
            future, self._future = self._future, None
            self._client.remove_pending_request(future)

    def close(self) -> None:
        """Give up the call in flight, if any, and destroy the client."""
        self.cancel()
        self._node.destroy_client(self._client)

    def _on_done(self, future: Any) -> None:
        if future is self._future:  # otherwise it was cancelled
            self._future = None
            self._on_response(future.result())


class RosSource:
    """Receives what one agent publishes; implements `Source`.

    ROS callbacks run in a thread of their own. They hand messages over to the asyncio loop in which
    `start` was called.

    Args:
        namespace: namespace of the agent; overridden by `--ros-args -r __ns:=`.
        ros_args: command-line arguments for rclpy.
        domain: ROS_DOMAIN_ID; by default from the environment.

    Raises:
        Exception: the namespace or the arguments are invalid; the type is rclpy's.
    """

    def __init__(
        self, namespace: str, ros_args: Sequence[str] = (), domain: int | None = None
    ) -> None:
        self.view = RobotView()
        self._thread = NodeThread(f"monitor_{os.getpid()}", namespace, ros_args, domain)
        self._node = self._thread.node
        self.name = self._node.get_namespace()
        self._parameters_call: _RepeatedCall | None = None
        """Call that requests the agent's parameters; None without an agent."""
        self._agent_name = ""
        """Name of the agent's node, with its namespace; empty without an agent."""
        self._first_answer_at = self._last_answer_at = 0.0
        """Times of the first and last answer to `_parameters_call`, in `time.monotonic` seconds; 0
        before."""
        self._address = ""
        """Address of the agent's robot, with its transport; empty if unknown."""
        self._doctor_command = "doctor"
        """Command that examines the agent's robot; without its address if that is unknown."""
        self._connected: bool | None = None
        """Last value of the topic `connected`; None before the first one."""
        self._invalid = (0, "")
        """Number of messages that could not be converted, and the last error."""
        self._crash: Exception | None = None
        """The exception that has ended the thread of the ROS callbacks; None while it runs."""
        self._needs_robot_info = True
        """True until the agent has answered with the robot's state since it was last connected."""
        self._robot_info_call: _RepeatedCall  # set by `start`, as is the next one
        self._loop: asyncio.AbstractEventLoop

    async def start(self) -> None:
        self._loop = asyncio.get_running_loop()
        srv = class_of(_ROBOT_INFO.srv, "srv")
        self._robot_info_call = _RepeatedCall(
            self._node,
            srv,
            _ROBOT_INFO.name,
            srv.Request(),
            _ROBOT_INFO_TIMEOUT,
            self._on_robot_info,
        )
        for topic in TOPICS:
            if not topic.on_demand:
                self._subscribe(topic.name, class_of(topic.msg, "msg"), topic.push, topic.depth)
        for action in ACTIONS:
            if action.member:  # the others start tasks, whose progress is on robot/TaskProc, too
                self._subscribe_feedback(
                    action.name, class_of(action.action, "action"), action.feedback
                )
        self._node.create_subscription(Bool, _CONNECTED, self._on_connected, latched(1))
        self._node.create_timer(_DISCOVERY_PERIOD, self._discover)
        self._thread.start(self._on_crash)

    async def close(self) -> None:
        await asyncio.to_thread(self._thread.close)

    def is_complete(self) -> bool:
        has_current_info = self.view.has_robot_info and not self._needs_robot_info
        return has_current_info and not self._is_awaiting_connected()

    def link(self) -> LinkReport:
        if self._crash is not None:
            return LinkReport(
                False,
                f"the monitor receives nothing more: internal error: {self._crash!r}",
                "restart the monitor, and report the problem",
            )
        if self._parameters_call is None:
            return LinkReport(
                False,
                f"no agent found in namespace {self.name}",
                "start it, or check --namespace and ROS_DOMAIN_ID",
            )
        silent = time.monotonic() - self._last_answer_at
        if silent > _AGENT_TIMEOUT:
            return LinkReport(
                False,
                f"the agent has not answered for {silent:.0f} s"
                if self._last_answer_at
                else "the agent has not answered yet",
                "restart the agent, or check the network between it and this computer",
            )
        address = self._address or "the robot"
        if self._connected is False:
            return LinkReport(
                False,
                f"the agent is not connected to {address}",
                f"see its log, or run `{self._doctor_command}` to find the cause",
            )
        if self._connected:
            return LinkReport(True, f"the agent is connected to {address}", self._unreadable_text())
        if self._is_awaiting_connected():
            return LinkReport(True, f"the agent answers; waiting for its topic {_CONNECTED}")
        detail = (
            f"it is unknown whether it is connected to {address}; see whether the agent's "
            f"parameter disabled_parts has {_CONNECTED}"
        )
        return LinkReport(
            True,
            f"the agent answers, but no message has come on its topic {_CONNECTED}",
            "; ".join(filter(None, (detail, self._unreadable_text()))),
        )

    def _is_awaiting_connected(self) -> bool:
        """Return True while the first message on `connected` can still be expected."""
        return (
            self._connected is None
            and time.monotonic() < self._first_answer_at + _CONNECTED_TIMEOUT
        )

    def _unreadable_text(self) -> str:
        count, error = self._invalid
        return f"{count} unreadable messages, the last one because of {error}" if count else ""

    # The methods below run in the executor thread.

    def _on_crash(self, error: Exception) -> None:
        self._crash = error

    def _subscribe(self, name: str, ros_class: Any, push: str, depth: int) -> None:
        update = partial(self._update, converter(ros_class, message_type(push)))
        self._node.create_subscription(ros_class, name, update, latched(depth))

    def _subscribe_feedback(self, name: str, action_class: Any, feedback: str) -> None:
        """Receive the feedback on all goals of an action, whichever client sent them."""
        message_class = action_class.Impl.FeedbackMessage
        feedback_class = type(message_class().feedback.fb)
        convert = converter(feedback_class, message_type(feedback))
        self._node.create_subscription(
            message_class,
            f"{name}/_action/feedback",
            lambda message: self._update(convert, message.feedback.fb),
            QoSProfile(depth=10),
        )

    def _update(self, convert: Converter, message: Any) -> None:
        """Convert a message, and hand it over to the view in the asyncio loop."""
        try:
            converted = convert.to_proto(message)
        except BadFieldError as error:  # robots do report values such as NaN
            self._invalid = self._invalid[0] + 1, str(error)
            return
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self.view.update, converted)

    def _on_connected(self, message: Any) -> None:
        if message.data and not self._connected:
            # An answer from before the connection can be outdated or empty.
            self._robot_info_call.cancel()
            self._needs_robot_info = True
        self._connected = message.data

    def _discover(self) -> None:
        """Find the agent, request its parameters, and request RobotInfo if it is needed.

        The answers with the parameters also show that the agent is alive.
        """
        agents = find_agents(self._node)
        found = {f"{namespace.rstrip('/')}/{name}" for name, namespace in agents}
        if self._agent_name not in found:
            # Forget nothing before the first agent: `_connected` may be of the agent found now.
            if self._parameters_call is not None:
                self._forget_agent()
            if not found:
                return
            self._set_agent(min(found))  # any of several agents, but always the same
        assert self._parameters_call is not None
        self._parameters_call.call()
        if self._needs_robot_info:
            self._robot_info_call.call()

    def _set_agent(self, name: str) -> None:
        self._last_answer_at = self._first_answer_at = 0.0
        self._address, self._doctor_command = "", "doctor"
        self._needs_robot_info = True
        request = GetParameters.Request(names=list(_PARAMETERS))
        self._parameters_call = _RepeatedCall(
            self._node,
            GetParameters,
            f"{name}/get_parameters",
            request,
            _PARAMETERS_TIMEOUT,
            self._on_parameters,
        )
        self._agent_name = name

    def _forget_agent(self) -> None:
        assert self._parameters_call is not None
        self._parameters_call.close()
        self._robot_info_call.cancel()
        self._parameters_call = self._connected = None
        self._agent_name = ""

    def _on_parameters(self, response: Any) -> None:
        if response.values:  # empty if the node lacks one of them, as that of `ros2 bag play` does
            self._set_address(response.values)
        self._last_answer_at = time.monotonic()
        self._first_answer_at = self._first_answer_at or self._last_answer_at

    def _set_address(self, values: Sequence[Any]) -> None:
        """Set the address, and the command of the doctor, from the values of `_PARAMETERS`."""
        transport, ip, port, encoding, robot_id = values
        self._address = url_host(ip.string_value)
        if port.integer_value:
            self._address += f":{port.integer_value}"
        self._address += f" over {transport.string_value}"
        config: dict[str, Any] = {
            "ip": ip.string_value,
            "port": port.integer_value,
            "transport": transport.string_value,
            "encoding": encoding.string_value,
            "robot_id": robot_id.integer_value,
        }
        with contextlib.suppress(ValueError):  # not the values of an agent
            self._doctor_command = f"doctor {link_arguments(LinkConfig(**config))}"

    def _on_robot_info(self, response: Any) -> None:
        self._update(converter(type(response.info), RobotInfo), response.info)
        self._needs_robot_info = False
