"""How many robots this machine serves at 20 Hz PoseSpeed each.

All robots push at the same moment, which is the hardest case. They are served if of each of them
99.9 % of the pushes reached a subscriber, and the 99th percentile of all latencies is below one
period. The chassis and the subscribers have the same cores; what they took is told.
"""

from __future__ import annotations

import contextlib
import json
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

from benchmarks.options import Measured, Options
from benchmarks.programs import Program, agent_command, echo_chassis, running
from benchmarks.pushes import Line, Row, subscribing
from tests.harness import own_domain

RATE = 20.0
TOGETHER = 5
"""Robots that come at a time; with several in one process, those that share one."""
MOST = 120
_IN_A_DOMAIN = 20
"""On the loopback, ROS finds no more than 32 participants in a domain."""
_SECONDS = 5.0


@dataclass
class _Domain:
    """Robots that are in one ROS domain, and who subscribes to them."""

    number: int
    namespaces: list[str] = field(default_factory=list)
    subscriber: Program | None = None
    ending: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)

    def subscribe(self) -> Program:
        """A subscriber to all of them, instead of the one there was."""
        self.ending.close()
        self.subscriber = self.ending.enter_context(subscribing(self.number, *self.namespaces))
        return self.subscriber


class Fleet:
    """Robots that grow in number: one chassis for all of them, and their agents.

    Args:
        options: how to measure.
        shared: several robots in one process, else each has its own.
    """

    def __init__(self, options: Options, *, shared: bool) -> None:
        self._options = options
        self._shared = shared
        self._stack = contextlib.ExitStack()
        self._domains: list[_Domain] = []
        self.agents: list[Program] = []
        self._line: Line | None = None
        self._chassis: Program | None = None
        self._port = 0

    def __enter__(self) -> Fleet:
        domain = self._stack.enter_context(own_domain())
        self._chassis, self._port = self._stack.enter_context(
            echo_chassis(domain, self._options.transport)
        )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for agent in self.agents:  # all at once: each takes half a second
            agent.stop()
        self._stack.__exit__(kind, error, traceback)

    @property
    def robots(self) -> int:
        """How many there are."""
        return sum(len(domain.namespaces) for domain in self._domains)

    def grow(self, count: int) -> None:
        """Add so many robots, and wait until they are connected and heard."""
        while count:
            if not self._domains or len(self._domains[-1].namespaces) >= _IN_A_DOMAIN:
                self._domains.append(_Domain(self._stack.enter_context(own_domain())))
                self._stack.push(self._domains[-1].ending)
            domain = self._domains[-1]
            some = min(count, TOGETHER, _IN_A_DOMAIN - len(domain.namespaces))
            names = [f"robot_{self.robots + i}" for i in range(some)]
            self._start(domain.number, names)
            domain.namespaces += [f"/{name}" for name in names]
            domain.subscriber = None
            count -= some
        assert self._chassis is not None
        subscribers = [each.subscriber or each.subscribe() for each in self._domains]
        if self._line is None:
            self._line = Line(self._chassis, self.agents, subscribers)
        self._line.subscribers = subscribers
        self._line.warm(2.0 * self._options.scale)

    def push(self) -> Row:
        """All push for a while."""
        assert self._line is not None
        return self._line.push(RATE, self._options.count(int(_SECONDS * RATE)))

    def _start(self, domain: int, names: list[str]) -> None:
        if self._shared:
            commands = [self._shared_command(names)]
        else:
            commands = [agent_command(self._port, self._options, f"/{name}") for name in names]
        started = [
            self._stack.enter_context(running(*command, domain=domain)) for command in commands
        ]
        for program in started:
            program.wait_says("connected to", len(names) // len(started))
        self.agents += started

    def _shared_command(self, names: list[str]) -> list[str]:
        """The agent with a file of parameters: one section for all, and one a robot."""
        address = {"ip": "127.0.0.1", "port": self._port}
        common = {"robots": [f"/{name}" for name in names], **self._options.agent}
        sections: dict[str, dict[str, object]] = {"/**": common}
        for number, name in enumerate(names, start=1):  # that the robots differ it would have
            sections[f"/{name}/agent"] = {**address, "robot_id": number}
        folder = self._stack.enter_context(tempfile.TemporaryDirectory())
        file = Path(folder, "fleet.yaml")
        # YAML takes JSON
        file.write_text(json.dumps({of: {"ros__parameters": v} for of, v in sections.items()}))
        return ["woosh_robot_agent.agent", "--ros-args", "--params-file", str(file)]


def served(row: Row) -> bool:
    """Whether all robots were served; see above."""
    return row.share >= 0.999 and row.latency.p99 < 1e6 / RATE and row.rate >= 0.99 * RATE


def most(options: Options, *, shared: bool) -> tuple[int, str]:
    """The most robots that are served, and what they took."""
    best, said = 0, "none"
    with Fleet(options, shared=shared) as fleet:
        while fleet.robots < (1 if options.smoke else MOST):
            fleet.grow(1 + shared if options.smoke else TOGETHER)
            row = fleet.push()
            if not served(row):
                row = fleet.push()  # a hiccup is not the limit
            if not served(row) and not options.smoke:
                break
            best, said = fleet.robots, told(row)
    return best, said


def told(row: Row) -> str:
    """Latency and CPU of a row."""
    return (
        f"{row.latency.median / 1000:.1f} (p99 {row.latency.p99 / 1000:.1f}) ms, CPU: agents "
        f"{percent(row, row.cpu):.0f} %, chassis {percent(row, row.chassis_cpu):.0f} %, "
        f"subscribers {percent(row, row.subscriber_cpu):.0f} %"
    )


def percent(row: Row, cpu: float) -> float:
    """CPU time as percent of a core."""
    return 100 * cpu / row.seconds


WAYS = {"one process a robot": False, f"{TOGETHER} in one process": True}
"""In words: whether several robots share a process."""


def fleet(_domain: int, options: Options) -> Measured:
    """The larger of both numbers, so that there is one to compare."""
    found = {words: most(options, shared=shared) for words, shared in WAYS.items()}
    said = "; ".join(f"{words}: {count} robots, {how}" for words, (count, how) in found.items())
    return {"fleet": (max(count for count, _ in found.values()), said)}
