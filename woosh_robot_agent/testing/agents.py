"""A simulated chassis, and the real agent before it: in this process or in one of its own."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any, Protocol

import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter

from woosh_robot_agent.agent import make_executor
from woosh_robot_agent.node import Agent
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread
from woosh_robot_agent.testing.domains import domain_variables, own_domain
from woosh_robot_agent.testing.spinning import Spinner
from woosh_robot_agent.testing.waiting import TIMEOUT, wait_until

NAMESPACE = "/woosh_robot"


@contextlib.contextmanager
def running_chassis(**options: Any) -> Iterator[SimulatorThread]:
    """A simulated chassis on free ports of this machine.

    Args:
        options: those of `SimulatorConfig`; time runs 10 times as fast as real time and the seed
            is 1, if they don't say otherwise.
    """
    config = SimulatorConfig(**{"port": 0, "tcp_port": 0, "speed": 10.0, "seed": 1, **options})
    with SimulatorThread(config) as chassis:
        yield chassis


class RunningAgent(Protocol):
    """An agent that runs.

    Attributes:
        domain: the ROS_DOMAIN_ID it is in.
        namespace: what its names begin with.
    """

    domain: int
    namespace: str

    def wait_connected(self, times: int = 1) -> None:
        """Return when the agent has connected to its chassis so many times since the start.

        Raises:
            AssertionError: it has not, in 60 s.
        """

    def close(self) -> None:
        """End it in good order, once."""


class AgentInProcess:
    """The agent in this process, with a context, an executor and a thread of its own.

    Args:
        domain: the ROS_DOMAIN_ID.
        namespace: what its names begin with.
        parameters: the agent's parameters.

    Attributes:
        agent: the `woosh_robot_agent.node.Agent`.

    Raises:
        ValueError: a parameter makes no sense.
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
        """See `RunningAgent.wait_connected`."""
        chassis = self.agent._chassis
        wait_until(
            lambda: chassis.stats.connects >= times and chassis.state.value == "ready", "the link"
        )

    def close(self) -> None:
        """See `RunningAgent.close`."""
        if self._closed:
            return
        self._closed = True
        try:
            self._spinner.stop()
        finally:
            self.agent.close(lambda: self.executor.spin_once(timeout_sec=0.02))
            self.executor.shutdown()  # as in `woosh_robot_agent.agent.main`
            rclpy.try_shutdown(context=self.context)


class AgentProcess:
    """The agent in a process of its own, as `ros2 run woosh_robot_agent agent` starts it.

    Args:
        domain: the ROS_DOMAIN_ID.
        namespace: what its names begin with.
        arguments: further ROS arguments, e.g. `-p`, `poll_timeout:=3000`.
        parameters: the agent's parameters.

    Attributes:
        process: the process.
        lines: what it has logged.
    """

    def __init__(
        self, domain: int, namespace: str = NAMESPACE, *arguments: str, **parameters: Any
    ) -> None:
        self.domain = domain
        self.namespace = namespace
        options = ["--ros-args", *(["-r", f"__ns:={namespace}"] if namespace else [])]
        for name, value in parameters.items():
            options += ["-p", f"{name}:={json.dumps(value)}"]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "woosh_robot_agent.agent", *options, *arguments],
            env={**os.environ, **domain_variables(domain), "PYTHONUNBUFFERED": "1"},
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read, name="agent's log", daemon=True)
        self._reader.start()

    @property
    def output(self) -> str:
        """Everything that it has logged."""
        return "".join(self.lines)

    def wait_says(self, text: str, times: int = 1) -> None:
        """Return when it has logged `text` so many times.

        Raises:
            AssertionError: it has not, in 60 s, or it has ended.
        """

        def said() -> bool:
            running = self.process.poll() is None
            if self.output.count(text) >= times:
                return True
            assert running, f"the agent ended ({self.process.returncode}): {self.output}"
            return False

        try:
            wait_until(said, repr(text))
        except AssertionError as error:
            raise AssertionError(f"{error}; the agent said: {self.output}") from None

    def wait_connected(self, times: int = 1) -> None:
        """See `RunningAgent.wait_connected`."""
        self.wait_says("connected to ", times)

    def close(self) -> None:
        """See `RunningAgent.close`."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(TIMEOUT)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self.wait_read()

    def wait_read(self) -> None:
        """Return when all that it logged is there; only once it has ended."""
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
    """The real agent, connected to `chassis`.

    Args:
        chassis: where it connects to.
        process: run it in a process of its own, as it runs on a robot; else in this one, where a
            debugger sees it and nothing has to start.
        domain: the ROS_DOMAIN_ID; by default one of its own, as `own_domain` gives it.
        namespace: what its names begin with.
        parameters: the agent's parameters; those of the link lead to `chassis`.

    Raises:
        AssertionError: it did not connect in 60 s.
        ValueError: a parameter makes no sense.
    """
    tcp = parameters.get("transport") == "tcp"
    link = {"ip": "127.0.0.1", "port": chassis.tcp_port if tcp else chassis.port}
    # a dropped link is there again at once: tests wait for it
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
