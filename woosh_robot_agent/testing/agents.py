"""A simulated chassis and the real agent, which runs in this process or in one of its own."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter

from woosh_robot_agent.agent import make_executor
from woosh_robot_agent.endpoints import NAMESPACE
from woosh_robot_agent.node import Agent
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread
from woosh_robot_agent.testing.domains import domain_variables, inherited_lock, own_domain
from woosh_robot_agent.testing.spinning import Spinner
from woosh_robot_agent.testing.waiting import TIMEOUT, wait_until

_SPIN_TIMEOUT = 0.02
"""Duration of one step of the executor while the agent closes, in seconds."""


@contextlib.contextmanager
def running_chassis(**options: Any) -> Iterator[SimulatorThread]:
    """Run a simulated chassis on free ports of this machine.

    Args:
        options: Options of `SimulatorConfig`. The defaults here are `speed=10.0`, `seed=1`, and
            `profile="instant"`, whose answers have no delay.
    """
    defaults = {"port": 0, "tcp_port": 0, "speed": 10.0, "seed": 1, "profile": "instant"}
    config = SimulatorConfig(**{**defaults, **options})
    with SimulatorThread(config) as chassis:
        yield chassis


class RunningAgent(Protocol):
    """A running agent.

    Attributes:
        domain: Its ROS_DOMAIN_ID.
        namespace: Its namespace.
    """

    domain: int
    namespace: str

    def wait_connected(self, times: int = 1) -> None:
        """Wait until the agent has connected to its chassis.

        Args:
            times: Number of connections since the start of the agent.

        Raises:
            AssertionError: It did not connect within 60 s.
        """

    def close(self) -> None:
        """End the agent as Ctrl-C does; further calls do nothing."""


class AgentInProcess:
    """The agent in this process, with its own context, executor and thread.

    Args:
        domain: ROS_DOMAIN_ID of the agent.
        namespace: Namespace of the agent.
        parameters: Parameters of the agent.

    Attributes:
        agent: The `woosh_robot_agent.node.Agent`.
        domain: ROS_DOMAIN_ID of the agent.
        namespace: Namespace of the agent.
        context: rclpy's context of the agent.
        executor: rclpy's executor of the agent.

    Raises:
        ValueError: A parameter is invalid.
    """

    def __init__(self, domain: int, namespace: str = NAMESPACE, **parameters: Any) -> None:
        self.domain = domain
        self.namespace = namespace
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

    def wait_connected(self, times: int = 1) -> None:
        chassis = self.agent._chassis
        wait_until(
            lambda: chassis.stats.connects >= times and chassis.state.value == "ready", "the link"
        )

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        try:
            self._spinner.stop()
        finally:
            self.agent.close(lambda: self.executor.spin_once(timeout_sec=_SPIN_TIMEOUT))
            self.executor.shutdown()
            rclpy.try_shutdown(context=self.context)


class AgentProcess:
    """The agent in its own process, as `ros2 run woosh_robot_agent agent` starts it.

    Args:
        domain: ROS_DOMAIN_ID of the agent.
        namespace: Namespace of the agent.
        arguments: Further ROS arguments, e.g. `-p`, `poll_timeout:=3000`.
        parameters: Parameters of the agent.

    Attributes:
        domain: ROS_DOMAIN_ID of the agent.
        namespace: Namespace of the agent.
        process: The process.
        lines: Lines that the agent has logged.
    """

    module = "woosh_robot_agent.agent"
    """Module that is started."""
    popen_options: Mapping[str, Any] = {"stdin": subprocess.DEVNULL}
    """Further options of `subprocess.Popen`."""

    def __init__(
        self, domain: int, namespace: str = NAMESPACE, *arguments: str, **parameters: Any
    ) -> None:
        self.domain = domain
        self.namespace = namespace
        options = ["--ros-args", *(["-r", f"__ns:={namespace}"] if namespace else [])]
        for name, value in parameters.items():
            options += ["-p", f"{name}:={json.dumps(value)}"]
        self.process = subprocess.Popen(
            [sys.executable, "-m", self.module, *options, *arguments],
            env={**os.environ, **domain_variables(domain), "PYTHONUNBUFFERED": "1"},
            stderr=subprocess.PIPE,
            text=True,
            pass_fds=inherited_lock(domain),
            **self.popen_options,
        )
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read, name="agent log", daemon=True)
        self._reader.start()

    @property
    def output(self) -> str:
        """Everything that the agent has logged."""
        return "".join(self.lines)

    def wait_says(self, text: str, times: int = 1) -> None:
        """Wait until the agent has logged `text`.

        Args:
            text: Part of a log message.
            times: Number of occurrences since the start of the agent.

        Raises:
            AssertionError: The text was not logged within 60 s, or the agent has ended.
        """

        def is_logged() -> bool:
            is_running = self.process.poll() is None
            if self.output.count(text) >= times:
                return True
            status = self.process.returncode
            assert is_running, f"the agent ended with status {status}: {self.output}"
            return False

        try:
            wait_until(is_logged, repr(text))
        except AssertionError as error:
            raise AssertionError(f"{error}; log of the agent: {self.output}") from None

    def wait_connected(self, times: int = 1) -> None:
        self.wait_says("connected to ", times)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(TIMEOUT)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self.wait_read()

    def wait_read(self) -> None:
        """Wait until all log messages of the ended agent have been read."""
        self._reader.join(TIMEOUT)
        assert self.process.stderr is not None
        self.process.stderr.close()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)


@contextlib.contextmanager
def running_agent(
    chassis: SimulatorThread,
    *,
    process: bool = False,
    domain: int | None = None,
    namespace: str = NAMESPACE,
    **parameters: Any,
) -> Iterator[RunningAgent]:
    """Run the real agent, connected to `chassis`.

    Args:
        chassis: The chassis to connect to.
        process: Run the agent in its own process, as on a robot. By default it runs in this
            process, which starts faster and can be debugged.
        domain: ROS_DOMAIN_ID of the agent; by default a new one from `own_domain`.
        namespace: Namespace of the agent.
        parameters: Parameters of the agent; `ip` and `port` are set to those of `chassis`.

    Raises:
        AssertionError: The agent did not connect within 60 s.
        ValueError: A parameter is invalid.
    """
    tcp = parameters.get("transport") == "tcp"
    link = {"ip": "127.0.0.1", "port": chassis.tcp_port if tcp else chassis.port}
    # Tests wait for the link after a drop: reconnect soon.
    parameters = {**link, "backoff_min": 0.1, **parameters}
    with contextlib.ExitStack() as stack:
        if domain is None:
            domain = stack.enter_context(own_domain())
        agent: RunningAgent
        kind = AgentProcess if process else AgentInProcess
        agent = kind(domain, namespace, **parameters)
        stack.callback(agent.close)
        agent.wait_connected()
        yield agent
