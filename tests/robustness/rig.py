"""A chassis, the agent and a client, kept running over many scenarios, and what may not grow there.

The agent and the chassis are in this process, so that one can look into them; between them is a
real socket, and between the agent and its client DDS.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import Log
from rclpy.logging import LoggingSeverity

from tests import harness
from tests.robustness.traffic import Surplus, Traffic
from woosh_robot_agent.actions.run import GoalRun
from woosh_robot_agent.link.transport.tcp import TcpTransport
from woosh_robot_agent.link.transport.websocket import WebSocketTransport
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread

SPEED = 20
"""How much faster than real time the chassis lives."""
BACKOFF_MAX = 0.2
MAX_FRAME_MIB = 8
PATIENCE: dict[str, Any] = {
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
"""The agent's parameters: as usual, but in haste."""
_POLL_PERIOD = 0.5
GIVE_UP = 20.0
"""s after which what should have happened counts as never happening, on the slowest machine."""

KINDS: tuple[dict[str, str], ...] = (
    {"transport": "websocket", "encoding": "json", "executor": "single"},
    {"transport": "websocket", "encoding": "json", "executor": "events"},
    {"transport": "websocket", "encoding": "protobuf", "executor": "single"},
    {"transport": "tcp", "encoding": "protobuf", "executor": "events"},
)
"""The ways in which the agent can be set up that matter to what happens under faults."""


class Trouble(Exception):
    """A promise was broken; the text says which."""


@dataclass(frozen=True)
class Footprint:
    """What an agent at rest holds; more than that after a scenario is a leak."""

    tasks: int
    threads: int
    files: int

    def within(self, other: Footprint) -> bool:
        return (
            self.tasks <= other.tasks
            and self.threads <= other.threads
            and self.files <= other.files
        )


class Rig:
    """Chassis, agent and client.

    Args:
        kind: transport, encoding and executor of the agent; one of `KINDS`.
        parameters: of the agent, instead of `PATIENCE`.

    Attributes:
        simulator: the chassis.
        agent: the agent.
        surplus: answers that came a second time.
        sent_twists: velocity commands that the agent handed to its sockets so far.
    """

    def __init__(self, kind: dict[str, str], parameters: dict[str, Any] | None = None) -> None:
        self._marks = itertools.count(1)
        self.surplus = Surplus()
        self.sent_twists = 0
        self._errors: list[str] = []
        self._footprint: Footprint | None = None
        with contextlib.ExitStack() as stack:
            domain = stack.enter_context(harness.own_domain())
            stack.enter_context(self._watched_logs())
            stack.enter_context(self._watched_sockets())
            stack.enter_context(_hurried_goals())
            self.simulator = stack.enter_context(
                SimulatorThread(SimulatorConfig(port=0, tcp_port=0, speed=SPEED))
            )
            port = self.simulator.tcp_port if kind["transport"] == "tcp" else self.simulator.port
            values = {**(PATIENCE if parameters is None else parameters), **kind}
            self.agent = harness.RunningAgent(domain, ip="127.0.0.1", port=port, **values)
            stack.callback(self.agent.close)
            stack.enter_context(self._quiet())
            self._client = harness.Client(domain)
            stack.callback(self._client.close)
            self._client.node.create_subscription(Log, "/rosout", self._rosout, 100)
            self.agent.wait_connected()
            self._stack = stack.pop_all()

    def close(self) -> None:
        """End all three."""
        self._stack.close()

    def traffic(self) -> Traffic:
        """A user's traffic, none yet."""
        return Traffic(self._client, self.surplus, self._marks)

    @property
    def errors(self) -> list[str]:
        """What was logged as an error so far, by anybody; empties the list."""
        told, self._errors = self._errors, []
        return told

    # What the agent is at

    def alive(self) -> None:
        """Raises Trouble if one of the agent's threads has ended or hangs."""
        if not self.agent._spinner._thread.is_alive():
            raise Trouble("the agent's executor has ended")
        self.in_link(lambda: None)

    def in_link(self, look: Callable[[], Any]) -> Any:
        """What `look` gives in the link's thread."""

        async def run() -> Any:
            return look()

        try:
            return self.agent.agent._thread.run(run(), GIVE_UP)
        except TimeoutError:
            raise Trouble("the agent's link thread hangs") from None

    @property
    def ready(self) -> bool:
        """Whether the link is up, as the agent has it."""
        return bool(self.agent.agent._chassis.state.value == "ready")

    def at_rest(self) -> str:
        """What the agent still holds on to; empty when nothing."""
        agent = self.agent.agent
        held = {
            "requests": agent._chassis.debug()["requests"],
            "velocity commands": len(agent._gate._velocities._unanswered),
            "goals": agent._actions.open_goals,
            "runs": sum(len(runs.open) for runs in agent._actions._runs),
        }
        return ", ".join(f"{count} {what}" for what, count in held.items() if count)

    def footprint(self) -> Footprint:
        """What the process holds now."""
        tasks = self.in_link(lambda: len(asyncio.all_tasks(self.agent.agent._thread.loop)) - 1)
        return Footprint(tasks, threading.active_count(), len(os.listdir("/proc/self/fd")))

    def check_footprint(self) -> None:
        """Compare with the first time; raises Trouble if there is more, and stays so."""
        if self._footprint is None:
            self._footprint = self.footprint()
            return
        deadline = time.monotonic() + GIVE_UP
        while not (now := self.footprint()).within(self._footprint):
            if time.monotonic() > deadline:
                names = self.in_link(
                    lambda: sorted(task.get_name() for task in asyncio.all_tasks())
                )
                raise Trouble(f"leak: {now}, at first {self._footprint}; link's tasks: {names}")
            time.sleep(0.02)

    # Watching

    def _rosout(self, log: Any) -> None:
        if log.level >= LoggingSeverity.ERROR:
            self._errors.append(f"{log.name}: {log.msg}")

    @contextlib.contextmanager
    def _quiet(self) -> Iterator[None]:
        """Only errors on the terminal: the rest is what faults are expected to bring."""
        logger = self.agent.agent.node.get_logger()
        logger.set_level(LoggingSeverity.ERROR)
        try:
            yield
        finally:
            logger.set_level(LoggingSeverity.UNSET)

    @contextlib.contextmanager
    def _watched_logs(self) -> Iterator[None]:
        handler = logging.Handler(logging.ERROR)
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
    def _watched_sockets(self) -> Iterator[None]:
        """Count the velocity commands that go out, at the last place before the network."""
        plain = {cls: cls.send for cls in (WebSocketTransport, TcpTransport)}

        def watched(cls: type[Any]) -> Any:
            async def send(transport: Any, data: str | bytes) -> None:
                if threading.current_thread().name == "link" and is_twist(data):
                    self.sent_twists += 1
                await plain[cls](transport, data)

            return send

        for cls in plain:
            cls.send = watched(cls)  # type: ignore[method-assign]
        try:
            yield
        finally:
            for cls, send in plain.items():
                cls.send = send  # type: ignore[method-assign]


def is_twist(data: str | bytes) -> bool:
    """Whether a frame is a velocity command."""
    name = "woosh.robot.Twist"
    return f'"{name}"' in data if isinstance(data, str) else name.encode() in data


@contextlib.contextmanager
def _hurried_goals() -> Iterator[None]:
    usual, GoalRun.poll_period = GoalRun.poll_period, _POLL_PERIOD
    try:
        yield
    finally:
        GoalRun.poll_period = usual
