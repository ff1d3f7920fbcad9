"""What the node's tests are made of: a simulated chassis, the real agent, a client beside it.

Both are real: the link goes over a socket, the rest over DDS, in a domain of the test's own.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from woosh_robot_agent.agent import make_executor
from woosh_robot_agent.node import Agent

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

NAMESPACE = "/woosh_robot"
TIMEOUT = 15.0
"""s after which a test gives up waiting; far above what anything here takes."""
_LOCK_PORT = 21000
_domains = iter(range(10_000_000))


@contextlib.contextmanager
def own_domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test on this machine uses now."""
    start = (os.getpid() * 17 + next(_domains)) % 100
    for offset in range(100):
        domain = 1 + (start + offset) % 100
        with socket.socket() as lock:
            try:
                lock.bind(("127.0.0.1", _LOCK_PORT + domain))
            except OSError:
                continue
            yield domain
            return
    raise RuntimeError("all domains are taken")


def wait_until(condition: Callable[[], Any], what: str = "", timeout: float = TIMEOUT) -> Any:
    """Wait for a condition that no event announces; returns what it gave."""
    deadline = time.monotonic() + timeout
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f"timed out waiting for {what or condition}")
        threading.Event().wait(0.005)
    return value


class Spinner:
    """Spins an executor in a thread until it is stopped."""

    def __init__(self, executor: Any) -> None:
        self.executor = executor
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(TIMEOUT)

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while not self._stop.is_set():
                self.executor.spin_once(timeout_sec=0.05)


class Collector:
    """What came on a topic, oldest first."""

    def __init__(self) -> None:
        self.messages: list[Any] = []
        self._changed = threading.Condition()

    def add(self, message: Any) -> None:
        with self._changed:
            self.messages.append(message)
            self._changed.notify_all()

    def wait(self, wanted: Callable[[Any], Any], timeout: float = TIMEOUT) -> Any:
        """The first message for which `wanted` is true, once it has come."""
        with self._changed:
            found = self._changed.wait_for(lambda: [m for m in self.messages if wanted(m)], timeout)
        assert found, f"nothing fitting among {self.messages}"
        return found[0]

    def wait_count(self, count: int, timeout: float = TIMEOUT) -> list[Any]:
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.messages) >= count, timeout), (
                f"{len(self.messages)} of {count} came: {self.messages}"
            )
            return list(self.messages)


class GoalClient:
    """One goal as its client sees it."""

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
        self._result = client.in_executor(self.handle.get_result_async)

    def result(self, timeout: float = TIMEOUT) -> tuple[int, Any]:
        """Status (action_msgs/GoalStatus) and `ret`, once the goal has ended."""
        response = wait_future(self._result, timeout)
        return response.status, response.result.ret

    @property
    def done(self) -> bool:
        return bool(self._result.done())

    def cancel(self) -> Any:
        """Ask to cancel; returns the action_msgs/CancelGoal response."""
        return wait_future(self._client.in_executor(self.handle.cancel_goal_async))


def wait_future(future: Any, timeout: float = TIMEOUT) -> Any:
    done = threading.Event()
    future.add_done_callback(lambda _future: done.set())
    assert done.wait(timeout), "no answer came"
    return future.result()


class Client:
    """A ROS node that uses the agent, in a context of its own."""

    def __init__(self, domain: int, namespace: str = NAMESPACE) -> None:
        self.namespace = namespace
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("client", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._spinner = Spinner(self.executor)
        self._clients: dict[Any, Any] = {}
        """By type and name: a service and an action may share a name."""

    def close(self) -> None:
        self._spinner.stop()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def in_executor(self, function: Callable[[], Any]) -> Any:
        """What `function` gives in the executor's thread.

        rclpy's action clients are for that thread alone: elsewhere an answer may be there before
        the request is noted down, and is then lost.
        """
        return wait_future(self.executor.create_task(function))

    def path(self, name: str) -> str:
        return name if name.startswith("/") else f"{self.namespace}/{name}"

    def service(self, srv: Any, name: str) -> Any:
        if (srv, name) not in self._clients:
            # as deep as the agent's: the usual depth of 10 loses answers that come in a burst
            client = self.node.create_client(
                srv, self.path(name), qos_profile=QoSProfile(depth=1000)
            )
            # rclpy's own wait looks every 0.25 s only
            wait_until(client.service_is_ready, f"the service {name}")
            self._clients[srv, name] = client
        return self._clients[srv, name]

    def call(self, srv: Any, name: str, timeout: float = TIMEOUT, **fields: Any) -> Any:
        """Call a service and wait for its answer."""
        return wait_future(self.call_async(srv, name, **fields), timeout)

    def call_async(self, srv: Any, name: str, **fields: Any) -> Any:
        return self.service(srv, name).call_async(srv.Request(**fields))

    def echo(self, msg: Any, name: str, depth: int = 100) -> Collector:
        """Subscribe as latched as the agent publishes."""
        collector = Collector()
        qos = QoSProfile(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
        self.node.create_subscription(msg, self.path(name), collector.add, qos)
        return collector

    def action(self, action: Any, name: str) -> ActionClient:
        if (action, name) not in self._clients:
            client = ActionClient(self.node, action, self.path(name))
            wait_until(client.server_is_ready, f"the action {name}")
            self._clients[action, name] = client
        return self._clients[action, name]

    def send_goal(self, action: Any, name: str, goal: Any) -> GoalClient:
        return GoalClient(self, self.action(action, name), goal)


class RunningAgent:
    """The agent in this process, with a context, an executor and a thread of its own."""

    def __init__(self, domain: int, namespace: str = NAMESPACE, **parameters: Any) -> None:
        self.context = Context()
        arguments = ["--ros-args", "-r", f"__ns:={namespace}"] if namespace else []
        rclpy.init(args=arguments, context=self.context, domain_id=domain)
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        try:
            self.agent = Agent(context=self.context, parameter_overrides=overrides)
        except BaseException:
            rclpy.try_shutdown(context=self.context)
            raise
        self.executor = make_executor(self.agent.settings.executor, self.context)
        self.executor.add_node(self.agent.node)
        self._spinner = Spinner(self.executor)
        self._closed = False

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self._spinner.stop()
        self.agent.close(lambda: self.executor.spin_once(timeout_sec=0.02))
        rclpy.try_shutdown(context=self.context)

    def wait_connected(self, times: int = 1) -> None:
        """Return when the link is ready, for so many times since the start."""
        chassis = self.agent._chassis
        wait_until(
            lambda: chassis.stats.connects >= times and chassis.state.value == "ready", "the link"
        )


class Program:
    """The agent in a process of its own."""

    def __init__(self, domain: int, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [
                *(sys.executable, "-m", "woosh_robot_agent.agent"),
                *("--ros-args", "-r", f"__ns:={NAMESPACE}", *arguments),
            ],
            env={**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONUNBUFFERED": "1"},
            stderr=subprocess.PIPE,
            text=True,
        )
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)

    @property
    def output(self) -> str:
        return "".join(self.lines)

    def wait_says(self, text: str) -> None:
        wait_until(lambda: text in self.output, f"{text!r} in {self.output!r}")

    def end(self, number: int = signal.SIGINT) -> float:
        """Send a signal and wait; returns the s that it took to end, in good order."""
        begun = time.monotonic()
        self.process.send_signal(number)
        status = self.process.wait(TIMEOUT)
        taken = time.monotonic() - begun
        self._reader.join(TIMEOUT)
        assert status == 0, self.output
        assert "Traceback" not in self.output, self.output
        return taken

    def wait_refused(self) -> str:
        """Wait for it to end with a complaint; returns that."""
        assert self.process.wait(TIMEOUT) not in (0, None)
        self._reader.join(TIMEOUT)
        return self.output
