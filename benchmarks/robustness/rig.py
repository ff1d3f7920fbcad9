"""A chassis, the agent and a client that keep running over many scenarios, and checks on them.

The agent and the chassis run in this process. Between them is a real socket, and between the agent
and its client there is DDS.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters
from rclpy.logging import LoggingSeverity

from benchmarks.robustness.traffic import DuplicateAnswers, Traffic
from tests.harness import Client
from tests.quick_chassis import quick_config
from woosh_robot_agent.link.transport import TcpTransport, WebSocketTransport
from woosh_robot_agent.robot import code_log
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import AgentInProcess, own_domain

SPEED = 20
"""Speed of the simulated chassis, as a multiple of real time."""
BACKOFF_MAX = 0.2
MAX_FRAME_MIB = 8
SHORT_TIMEOUTS: dict[str, Any] = {
    "poll_timeout": 400,
    "connect_timeout": 1.0,
    "handshake_timeout": 5.0,
    "close_timeout": 0.2,
    "liveness_timeout": 0.8,
    "backoff_min": 0.1,
    "backoff_max": BACKOFF_MAX,
    "stable_after": 0.5,
    "goal_link_timeout": 0.6,
    "max_frame_size": MAX_FRAME_MIB * 1024 * 1024,
}
"""Parameters of the agent: timeouts so short that a scenario takes about a second."""
_POLL_PERIOD = 0.5
"""Time between two queries for the state of a silent goal, in seconds."""
NEVER = 60.0
"""Timeout for anything that must happen, in seconds."""

KINDS: tuple[dict[str, str], ...] = (
    {"transport": "websocket", "encoding": "json"},
    {"transport": "websocket", "encoding": "protobuf"},
    {"transport": "tcp", "encoding": "protobuf"},
)
"""Transport and encoding of the agent, which influence its reaction to faults."""


class BrokenPromiseError(Exception):
    """The agent broke a promise, which the text names."""


class Footprint(NamedTuple):
    """Resources of the process at rest. Growth from one scenario to the next is a leak.

    Attributes:
        tasks: number of asyncio tasks in the link thread.
        threads: number of threads.
        files: number of open files.
    """

    tasks: int
    threads: int
    files: int

    def within(self, other: Footprint) -> bool:
        """Return True if no number is higher than in `other`."""
        return all(mine <= theirs for mine, theirs in zip(self, other, strict=True))


class Rig:
    """A chassis, an agent and a client.

    Args:
        kind: transport and encoding of the agent; one of `KINDS`.
        parameters: further parameters of the agent, by default `SHORT_TIMEOUTS`.

    Attributes:
        simulator: the chassis.
        agent: the agent.
        duplicates: answers to calls that were answered already.
        sent_twists: number of velocity commands that the agent has handed to its sockets.
    """

    def __init__(self, kind: dict[str, str], parameters: dict[str, Any] | None = None) -> None:
        self._marks = itertools.count(1)
        self.duplicates = DuplicateAnswers()
        self.sent_twists = 0
        self._errors: list[str] = []
        self._footprint: Footprint | None = None
        with contextlib.ExitStack() as stack:
            domain = stack.enter_context(own_domain())
            stack.enter_context(self._record_errors())
            stack.enter_context(self._count_twists())
            self.simulator = stack.enter_context(
                SimulatorThread(quick_config(port=0, tcp_port=0, speed=SPEED))
            )
            port = self.simulator.tcp_port if kind["transport"] == "tcp" else self.simulator.port
            values = {**(SHORT_TIMEOUTS if parameters is None else parameters), **kind}
            self.agent = AgentInProcess(domain, ip="127.0.0.1", port=port, **values)
            stack.callback(self.agent.close)
            actions = self.agent.agent.actions
            actions.timing = replace(actions.timing, poll_period=_POLL_PERIOD)
            stack.enter_context(self._only_errors_on_terminal())
            self._client = Client(domain)
            stack.callback(self._client.close)
            self._client.node.create_subscription(Log, "/rosout", self._record_rosout, 100)
            self.agent.wait_connected()
            self._stack = stack.pop_all()

    def close(self) -> None:
        """Stop client, agent and chassis."""
        self._stack.close()

    def traffic(self) -> Traffic:
        """Return the traffic of a new scenario."""
        return Traffic(self._client, self.duplicates, self._marks)

    def take_errors(self) -> list[str]:
        """Return the errors that were logged since the last call."""
        errors, self._errors = self._errors, []
        return errors

    # The state of the agent

    def check_alive(self) -> None:
        """Raise BrokenPromiseError if the agent's executor or its link thread does not respond."""
        self.debug()
        try:
            self._client.call(GetParameters, "agent/get_parameters", NEVER, names=["ip"])
        except AssertionError:
            raise BrokenPromiseError("the agent's executor has ended or hangs") from None

    def debug(self) -> dict[str, Any]:
        """Return the debug state of the agent.

        Raises:
            BrokenPromiseError: the link thread does not answer.
        """
        try:
            return self.agent.agent.debug()
        except TimeoutError:
            raise BrokenPromiseError("the agent's link thread hangs") from None

    @property
    def ready(self) -> bool:
        """True if the agent considers its link ready."""
        return bool(self.debug()["state"] == "ready")

    def in_flight(self) -> str:
        """Return what is in flight in the agent; empty if it is at rest."""
        state = self.debug()
        names = ("requests", "pushes", "goals", "running_goals")
        return ", ".join(f"{state[name]} {name}" for name in names if state[name])

    def footprint(self) -> Footprint:
        """Return the current footprint."""
        tasks = len(self.debug()["tasks"])
        return Footprint(tasks, threading.active_count(), len(os.listdir("/proc/self/fd")))

    def check_footprint(self) -> None:
        """Compare the footprint with that of the first call.

        Raises:
            BrokenPromiseError: it has grown, and does not shrink again in time.
        """
        if self._footprint is None:
            self._footprint = self.footprint()
            return
        deadline = time.monotonic() + NEVER
        while not (now := self.footprint()).within(self._footprint):
            if time.monotonic() > deadline:
                raise BrokenPromiseError(
                    f"leak: {now}, at first {self._footprint}; tasks: {self.debug()['tasks']}"
                )
            time.sleep(0.02)

    # Recording

    # Faults that the robot reports are logged as errors, but they are no errors of the agent.

    def _record_rosout(self, log: Any) -> None:
        if log.level >= LoggingSeverity.ERROR and not log.file.endswith(code_log.__file__):
            self._errors.append(f"{log.name}: {log.msg}")

    @contextlib.contextmanager
    def _only_errors_on_terminal(self) -> Iterator[None]:
        """Hide warnings on the terminal, because faults are expected to cause them."""
        logger = self.agent.agent.node.get_logger()
        logger.set_level(LoggingSeverity.ERROR)
        try:
            yield
        finally:
            logger.set_level(LoggingSeverity.UNSET)

    @contextlib.contextmanager
    def _record_errors(self) -> Iterator[None]:
        """Record what Python code logs as an error."""
        handler = logging.Handler(logging.ERROR)
        handler.addFilter(lambda record: record.name != code_log.__name__)
        handler.emit = lambda record: self._errors.append(  # type: ignore[method-assign]
            logging.Formatter("%(name)s: %(message)s").format(record)
        )
        loggers = [logging.getLogger(name) for name in ("woosh_robot_agent", "asyncio")]
        for logger in loggers:
            logger.addHandler(handler)
        try:
            yield
        finally:
            for logger in loggers:
                logger.removeHandler(handler)

    @contextlib.contextmanager
    def _count_twists(self) -> Iterator[None]:
        """Count the velocity commands that the agent passes to its transport."""
        original = {cls: cls.send for cls in (WebSocketTransport, TcpTransport)}

        def counting(cls: type[Any]) -> Any:
            async def send(transport: Any, data: str | bytes) -> None:
                if threading.current_thread().name == "link" and is_twist(data):
                    self.sent_twists += 1
                await original[cls](transport, data)

            return send

        for cls in original:
            cls.send = counting(cls)  # type: ignore[method-assign]
        try:
            yield
        finally:
            for cls, send in original.items():
                cls.send = send  # type: ignore[method-assign]


def is_twist(data: str | bytes) -> bool:
    """Return True if a frame is a velocity command."""
    name = "woosh.robot.Twist"
    return f'"{name}"' in data if isinstance(data, str) else name.encode() in data
