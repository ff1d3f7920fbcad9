"""Agents, ROS domains and spinning nodes, for tests of nodes that use an agent. Needs ROS 2."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from functools import partial
from typing import Any, Protocol

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.parameter import Parameter

from woosh_robot_agent.endpoints import NAMESPACE
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.parameters import PARAMETERS
from woosh_robot_agent.ros.bridge import LoopThread
from woosh_robot_agent.ros.executor import Executor
from woosh_robot_agent.ros.node import Agent, ParameterNode, stop_all
from woosh_robot_agent.ros.releases import this_computer_only
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing.chassis import TIMEOUT, wait_until

_LOCK_PORT = 21000
"""Base of the TCP ports that lock a domain for all processes of this machine.

Domain N is in use while the port `_LOCK_PORT` + N is bound.
"""
_DOMAINS = 100
"""Number of domains for tests; the first one is 1."""
_counter = itertools.count()
"""Number of calls of `own_domain`, so that each call tries another domain first."""
_locks: dict[int, socket.socket] = {}
"""Bound sockets of the domains that this process uses, by domain."""


@contextlib.contextmanager
def own_domain() -> Iterator[int]:
    """Yield a ROS_DOMAIN_ID that no other test on this machine uses, limited to this machine.

    Meanwhile it is set in the environment, so `rclpy.init()` and child processes use this domain.

    Raises:
        RuntimeError: all domains for tests are in use.
    """
    domain, lock = _lock_domain()
    _locks[domain] = lock
    try:
        with pytest.MonkeyPatch.context() as patch:
            for name, value in domain_variables(domain).items():
                patch.setenv(name, value)
            yield domain
    finally:
        del _locks[domain]
        lock.close()


def _lock_domain() -> tuple[int, socket.socket]:
    """Return a domain that is not in use, and the socket that locks it until it is closed."""
    # processes that start one after the other begin at distant domains
    start = (os.getpid() * 17 + next(_counter)) % _DOMAINS
    for offset in range(_DOMAINS):
        domain = 1 + (start + offset) % _DOMAINS
        lock = socket.socket()
        try:
            lock.bind(("127.0.0.1", _LOCK_PORT + domain))
        except OSError:
            lock.close()
        else:
            return domain, lock
    raise RuntimeError(f"all {_DOMAINS} ROS domains for tests are in use on this machine")


def _inherited_lock(domain: int) -> tuple[int, ...]:
    """Return the file descriptors that a child process in a domain must inherit.

    They keep the domain in use for as long as the process runs, even if the test is killed. There
    are none if the domain is not one of `own_domain`.
    """
    return (_locks[domain].fileno(),) if domain in _locks else ()


def domain_variables(domain: int) -> dict[str, str]:
    """Return the environment variables of a process in a domain, limited to this machine."""
    return {"ROS_DOMAIN_ID": str(domain), **this_computer_only()}


_IDLE_SPIN_TIMEOUT = 1.0
"""Maximum duration of a call of `spin_once` without work, in seconds."""


class Spinner:
    """Spins an executor in a thread until it is stopped.

    An exception of a callback ends the spinning; `stop` raises it again.

    Args:
        executor: the executor, to which the caller adds the nodes.
    """

    def __init__(self, executor: Any) -> None:
        self.executor = executor
        self._stop = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._spin, name="spinner", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop spinning and wait for the thread; raise the exception of a callback, if any."""
        self._stop.set()
        self.executor.create_task(lambda: None)  # ends `spin_once`; `wake` would not
        self._thread.join(TIMEOUT)
        if self._error is not None:
            raise self._error

    def _spin(self) -> None:
        try:
            while not self._stop.is_set():
                self.executor.spin_once(timeout_sec=_IDLE_SPIN_TIMEOUT)
        except ExternalShutdownException:
            pass
        except BaseException as error:
            self._error = error


@contextlib.contextmanager
def spinning(*nodes: Any) -> Iterator[None]:
    """Spin nodes in a thread; at the end, raise the exception of a callback, if any.

    Args:
        nodes: nodes of one context.
    """
    executor = SingleThreadedExecutor(context=nodes[0].context)
    for node in nodes:
        executor.add_node(node)
    with contextlib.ExitStack() as stack:
        stack.callback(executor.shutdown)
        stack.callback(Spinner(executor).stop)
        yield


_STOP_TIMEOUT = 0.3
"""Timeout for the end of the agent's link thread, in seconds."""
_CLOSING_SPIN_TIMEOUT = 0.02
"""Maximum duration of a call of `spin_once` while the agent closes, in seconds."""


class RunningAgent(Protocol):
    """A running agent.

    Attributes:
        domain: ROS_DOMAIN_ID of the agent.
        namespace: namespace of the agent.
    """

    domain: int
    namespace: str

    def wait_connected(self, times: int = 1) -> None:
        """Wait until the agent has connected to its chassis.

        Args:
            times: number of connections since the start of the agent.

        Raises:
            AssertionError: the agent did not connect within 60 s.
        """

    def close(self) -> None:
        """End the agent as Ctrl-C does; further calls do nothing."""


_LINK_FIELDS = {field.name for field in fields(LinkConfig)} - {p.name for p in PARAMETERS}
"""Fields of `LinkConfig` that are not parameters of the agent."""
_STALL = 10.0
"""Minimum duration of a stall of this process, in seconds. After a stall, the agent refuses the
commands from before its end. Longer than on a robot: a busy test machine stalls for longer."""


class AgentInProcess:
    """The agent in this process, with its own context, executor and thread.

    Args:
        parameters: parameters of the agent, and fields of `LinkConfig`, e.g. `backoff_min`.

    Attributes:
        agent: the `woosh_robot_agent.ros.node.Agent`.
        domain: ROS_DOMAIN_ID of the agent.
        namespace: namespace of the agent.
        context: rclpy's context of the agent.

    Raises:
        ValueError: a parameter is invalid.
    """

    def __init__(self, domain: int, namespace: str = NAMESPACE, **parameters: Any) -> None:
        self.domain = domain
        self.namespace = namespace
        self.context = Context()
        arguments = ["--ros-args", "-r", f"__ns:={namespace}"] if namespace else []
        rclpy.init(args=arguments, context=self.context, domain_id=domain)
        link = {name: parameters.pop(name) for name in _LINK_FIELDS & parameters.keys()}
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        try:
            node = ParameterNode(context=self.context, parameter_overrides=overrides)
            self._thread = LoopThread()
            self.agent = Agent(node, self._thread, link)
        except BaseException:
            rclpy.try_shutdown(context=self.context)
            raise
        gate = self.agent.robot.gate
        gate.timing = replace(gate.timing, stall=_STALL)
        self.executor = Executor(context=self.context)
        self.executor.add_node(self.agent.node)
        self._spinner = Spinner(self.executor)
        self._closed = False

    def wait_connected(self, times: int = 1) -> None:
        chassis = self.agent.robot.chassis
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
            # the results of goals must still reach their clients
            spin_once = partial(self.executor.spin_once, timeout_sec=_CLOSING_SPIN_TIMEOUT)
            stop_all([self.agent], spin_once)
            self.agent.destroy()
            self._thread.stop(_STOP_TIMEOUT)
            self.executor.shutdown()
            rclpy.try_shutdown(context=self.context)


class AgentProcess:
    """The agent in its own process, as `ros2 run woosh_robot_agent agent` starts it.

    Args:
        arguments: further ROS arguments, e.g. `-p`, `poll_timeout:=3000`.

    Attributes:
        domain: ROS_DOMAIN_ID of the agent.
        namespace: namespace of the agent.
        lines: lines that the agent has logged so far, each with its line end.
    """

    # Subclasses may override the module to run, and options of `subprocess.Popen`.
    module = "woosh_robot_agent.agent"
    popen_options: Mapping[str, Any] = {"stdin": subprocess.DEVNULL}

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
            pass_fds=_inherited_lock(domain),
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
            times: number of occurrences since the start of the agent.

        Raises:
            AssertionError: the text was not logged within 60 s, or the agent ended without it.
        """

        def is_logged() -> bool:
            is_running = self.process.poll() is None  # before `output`, so that no text is missed
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
        self.wait_says(": connected to ", times)  # the colon excludes "not connected to"

    def close(self) -> None:
        """End the agent by SIGINT, or kill it after `TIMEOUT`; idempotent."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(TIMEOUT)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self.wait_read()

    def wait_read(self) -> None:
        """Wait, for `TIMEOUT` at most, until the log of the ended agent is read; then close it."""
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
        process: True to run the agent in its own process, as on a robot. By default it runs in
            this process, which starts faster and can be debugged.
        domain: ROS_DOMAIN_ID of the agent; by default a new one from `own_domain`.
        parameters: parameters of the agent, e.g. `transport="tcp"`; by default, `ip` and `port`
            lead to `chassis`. In this process, also fields of `LinkConfig`.

    Raises:
        AssertionError: the agent did not connect within 60 s, or its process has ended.
        RuntimeError: all domains for tests are in use.
        ValueError: a parameter is invalid, and the agent runs in this process.
    """
    tcp = parameters.get("transport") == "tcp"
    link: dict[str, Any] = {"ip": "127.0.0.1", "port": chassis.tcp_port if tcp else chassis.port}
    if not process:  # a process takes only parameters of the agent, and `backoff_min` is none
        link["backoff_min"] = 0.1  # reconnect soon: tests wait for the link after a drop
    parameters = {**link, **parameters}
    with contextlib.ExitStack() as stack:
        if domain is None:
            domain = stack.enter_context(own_domain())
        agent: RunningAgent
        kind = AgentProcess if process else AgentInProcess
        agent = kind(domain, namespace, **parameters)
        stack.callback(agent.close)
        agent.wait_connected()
        yield agent
