"""Maximum number of robots that this machine can serve when each pushes PoseSpeed at 20 Hz.

All robots push at the same moment, which is the hardest case. They count as served if at least
99.9 % of the pushes of every robot reach a subscriber, the 99th percentile of all latencies is
below one period, and the chassis reaches 99 % of the rate. Chassis and subscribers share the cores
with the agents; their CPU time is reported.
"""

from __future__ import annotations

import contextlib
import json
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

from benchmarks.figures import MICROSECONDS, Measured, Target
from benchmarks.measurements.pushes import PushPath, PushRun, subscribing
from benchmarks.options import Options
from benchmarks.processes import Program, agent_command, running, running_chassis
from woosh_robot_agent.testing import own_domain

FIGURES = {
    "fleet": Target(None, 60, "robots served at 20 Hz each, in the better of two ways", True),
}
RATE = 20.0
"""Rate at which each robot pushes, in Hz."""
STEP = 5
"""Number of robots added at a time, and number of robots that share a process."""
MAX_ROBOTS = 120
"""Maximum number of robots that a measurement tries."""
WAYS = {"one process per robot": 1, f"{STEP} robots per process": STEP}
"""The two ways to run several robots, with the number of robots in a process."""
_MAX_PER_DOMAIN = 20
"""Number of robots per ROS domain. DDS discovers at most 32 participants on the loopback."""
_DURATION = 5.0


@dataclass
class _Domain:
    """One ROS domain with its robots and their subscriber."""

    number: int
    namespaces: list[str] = field(default_factory=list)
    subscriber: Program | None = None
    stack: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)

    def subscribe(self) -> Program:
        """Replace the subscriber by one that listens to all robots of the domain."""
        self.stack.close()
        self.subscriber = self.stack.enter_context(subscribing(self.number, *self.namespaces))
        return self.subscriber


class Fleet:
    """A growing number of robots with their agents, and one chassis that plays all of them.

    Args:
        options: options of the measurement.
        per_process: number of robots in a process.

    Attributes:
        agents: programs that run the agents.
    """

    def __init__(self, options: Options, *, per_process: int) -> None:
        self._options = options
        self._per_process = per_process
        self._stack = contextlib.ExitStack()
        self._domains: list[_Domain] = []
        self.agents: list[Program] = []
        self._path: PushPath | None = None
        self._chassis: Program | None = None
        self._port = 0

    def __enter__(self) -> Fleet:
        domain = self._stack.enter_context(own_domain())
        self._chassis, self._port = self._stack.enter_context(running_chassis(domain))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for agent in self.agents:  # all at once, because each takes half a second to end
            agent.interrupt()
        self._stack.__exit__(kind, error, traceback)

    @property
    def robots(self) -> int:
        """Number of robots."""
        return sum(len(domain.namespaces) for domain in self._domains)

    def grow(self, count: int) -> None:
        """Add robots, and wait until they are connected and their pushes arrive."""
        while count:
            if not self._domains or len(self._domains[-1].namespaces) >= _MAX_PER_DOMAIN:
                self._domains.append(_Domain(self._stack.enter_context(own_domain())))
                self._stack.push(self._domains[-1].stack)
            domain = self._domains[-1]
            step = max(STEP, self._per_process)
            added = min(count, step, _MAX_PER_DOMAIN - len(domain.namespaces))
            names = [f"robot_{self.robots + i}" for i in range(added)]
            self._start(domain.number, names)
            domain.namespaces += [f"/{name}" for name in names]
            domain.subscriber = None
            count -= added
        assert self._chassis is not None
        subscribers = [each.subscriber or each.subscribe() for each in self._domains]
        if self._path is None:
            self._path = PushPath(self._chassis, self.agents, subscribers)
        self._path.subscribers = subscribers
        self._path.warm_up(2.0 * self._options.scale)

    def push(self) -> PushRun:
        """Let all robots push for a while."""
        assert self._path is not None
        return self._path.push(RATE, self._options.samples(int(_DURATION * RATE)))

    def _start(self, domain: int, names: list[str]) -> None:
        if self._per_process > 1:
            commands = [self._shared_command(names)]
        else:
            commands = [agent_command(self._port, self._options, f"/{name}") for name in names]
        started = [
            self._stack.enter_context(running(*command, domain=domain)) for command in commands
        ]
        for program in started:
            program.wait_logged("connected to", len(names) // len(started))
        self.agents += started

    def _shared_command(self, names: list[str]) -> list[str]:
        """Return the command of one agent process for several robots."""
        common = {"robots": [f"/{name}" for name in names], **self._options.agent_parameters}
        sections: dict[str, dict[str, object]] = {"/**": common | {"port": self._port}}
        for number, name in enumerate(names, start=1):
            # the agent refuses two robots with the same address
            sections[f"/{name}/agent"] = {"ip": f"127.0.0.{number}"}
        folder = self._stack.enter_context(tempfile.TemporaryDirectory())
        file = Path(folder, "fleet.yaml")
        content = {node: {"ros__parameters": each} for node, each in sections.items()}
        file.write_text(json.dumps(content))  # JSON is valid YAML
        return ["woosh_robot_agent.agent", "--ros-args", "--params-file", str(file)]


def served(run: PushRun) -> bool:
    """Return True if all robots were served, as the module's docstring defines it."""
    return (
        run.received_share >= 0.999
        and run.latency.p99 < MICROSECONDS / RATE
        and run.rate >= 0.99 * RATE
    )


def max_robots(options: Options, *, per_process: int) -> tuple[int, str]:
    """Return the maximum number of robots that are served, and their cost as text."""
    best, description = 0, "none"
    with Fleet(options, per_process=per_process) as fleet:
        while fleet.robots < (1 if options.smoke else MAX_ROBOTS):
            fleet.grow(min(2, per_process) if options.smoke else STEP)
            run = fleet.push()
            if not served(run) and not options.smoke:
                run = fleet.push()  # a single failure may be a hiccup of the machine
            if not served(run) and not options.smoke:
                break
            best, description = fleet.robots, _describe(run)
    return best, description


def _describe(run: PushRun) -> str:
    """Return latency and CPU of a run as text."""
    return (
        f"{run.latency.median / 1000:.1f} (p99 {run.latency.p99 / 1000:.1f}) ms, CPU: agents "
        f"{run.percent(run.cpu):.0f} %, chassis {run.percent(run.chassis_cpu):.0f} %, "
        f"subscribers {run.percent(run.subscriber_cpu):.0f} %"
    )


def measure(_domain: int, options: Options) -> Measured:
    """Measure the maximum number of robots in both ways; the figure is the higher one."""
    found = {way: max_robots(options, per_process=count) for way, count in WAYS.items()}
    text = "; ".join(f"{way}: {count} robots, {cost}" for way, (count, cost) in found.items())
    return {"fleet": (max(count for count, _ in found.values()), text)}
