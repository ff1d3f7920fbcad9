"""Cost of an idle agent, and its start-up time; the same of Nav2's interfaces."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from nav2_msgs import action as nav2_actions
from std_msgs.msg import Bool

from benchmarks.figures import Measured, Target
from benchmarks.options import Options
from benchmarks.processes import MIB, Program, agent_command, running, running_chassis
from tests.harness import Client
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, QUERIES, TOPICS
from woosh_robot_agent.ros.standard_endpoints import NAV2, STANDARD, Kind
from woosh_robot_agent.testing import wait_until

FIGURES = {
    "idle_rss": Target(1.35, 1.15, "resident memory / a node with the same entities"),
    "idle_cpu": Target(1.0, 0.3, "percent of a core, connected and unused"),
    "startup": Target(
        1.4, 1.2, "start to connected and discovered / a node with the same entities"
    ),
}
NAV2_FIGURES = {
    "nav2_idle_rss": Target(8.0, 6.0, "memory of Nav2's interfaces: agent with / without, in MiB"),
    "nav2_idle_cpu": Target(0.1, 0.05, "CPU of them, connected and unused, in percent of a core"),
    "nav2_startup": Target(1.1, 1.05, "start of an agent with them / without"),
}
_STARTS = 5
"""Number of starts; the figure is their median."""
_START_TIMEOUT = 300.0
"""Time in which a program must have started, in seconds. A very busy machine takes minutes."""
_IDLE = 20.0
"""Time for which an idle program is measured, in seconds."""
_IDLE_AT_LEAST = 2.5
"""The same in a smoke run, in seconds: in less time, an idle agent may use no CPU time at all."""
_POLL = 0.02
"""Period of polling for endpoints, in seconds. Polling takes CPU time that the start needs too."""
_KINDS = {Kind.SERVICE: "service", Kind.INPUT: "subscription", Kind.LATCHED: "latched"}


def entities() -> Iterator[str]:
    """Yield the agent's default entities, in the form that `benchmarks.floors.entities` takes."""
    for service in (*QUERIES, *COMMANDS):
        yield f"service:{service.srv}:{service.name}:0"
    for topic in TOPICS:
        yield f"latched:{topic.msg}:{topic.name}:{topic.depth}"
    for action in ACTIONS:
        yield f"action:{action.action}:{action.name}:0"
    for entry in STANDARD:
        if not entry.name.startswith("/tf"):
            kind = _KINDS.get(entry.kind, "publisher")
            yield f"{kind}:{entry.type}:{entry.name}:{entry.depth}"


def floor_command(nodes: int) -> list[str]:
    """Return module and arguments of the floor with a number of nodes."""
    return ["benchmarks.floors.entities", str(nodes), *entities()]


def measure(domain: int, options: Options) -> Measured:
    """Measure several starts of agent and floor in turn, then both while idle."""
    with running_chassis(domain) as (_, port):
        ours, floor = _measure_in_turn(
            domain,
            options,
            MeasuredProgram(agent_command(port, options)),
            MeasuredProgram(floor_command(1), connects=False),
        )
    return {
        "idle_rss": (ours.rss / floor.rss, f"{ours.rss:.1f} / {floor.rss:.1f} MiB"),
        "idle_cpu": (ours.cpu, f"{ours.cpu:.2f} %, floor {floor.cpu:.2f} %"),
        "startup": (ours.start / floor.start, f"{ours.start:.2f} / {floor.start:.2f} s"),
    }


def measure_nav2(domain: int, options: Options) -> Measured:
    """Measure an agent with Nav2's interfaces and one without in turn."""
    actions = [
        each.name
        for each in NAV2
        if each.kind is Kind.ACTION and hasattr(nav2_actions, each.type.partition("/")[2])
    ]
    with running_chassis(domain) as (_, port):
        nav2, bare = _measure_in_turn(
            domain,
            options,
            MeasuredProgram(agent_command(port, options, nav2="true"), further_actions=actions),
            MeasuredProgram(agent_command(port, options)),
        )
    return {
        "nav2_idle_rss": (nav2.rss - bare.rss, f"{nav2.rss:.1f} - {bare.rss:.1f} MiB"),
        "nav2_idle_cpu": (nav2.cpu - bare.cpu, f"{nav2.cpu:.3f} - {bare.cpu:.3f} %"),
        "nav2_startup": (nav2.start / bare.start, f"{nav2.start:.2f} / {bare.start:.2f} s"),
    }


@dataclass
class MeasuredProgram:
    """A program that is measured while it starts and while it is idle.

    Attributes:
        command: its module and arguments.
        connects: False if it has no link to wait for.
        further_actions: names of actions that it has beside those of the agent.
        starts: time of each start, in seconds.
        cpu: CPU time while idle, in percent of a core.
        rss: resident memory while idle, in MiB.
    """

    command: list[str]
    connects: bool = True
    further_actions: Sequence[str] = ()
    starts: list[float] = field(default_factory=list)
    cpu: float = math.nan
    rss: float = math.nan

    @property
    def start(self) -> float:
        """Median time of the starts, in seconds."""
        return statistics.median(self.starts)


def _measure_in_turn(
    domain: int, options: Options, *programs: MeasuredProgram
) -> tuple[MeasuredProgram, ...]:
    """Start each program several times in turn, then measure each while idle."""
    for turn in reversed(range(1 if options.smoke else _STARTS)):
        for each in programs:
            watcher = Watcher(domain, each.further_actions)
            with running(*each.command, domain=domain) as program:
                watcher.wait_started(connected=each.connects)
                each.starts.append(time.monotonic() - program.started)
                watcher.close()
                if turn == 0:
                    each.cpu, each.rss = _idle(program, options)
            _wait_gone(domain)
    return programs


def _idle(program: Program, options: Options) -> tuple[float, float]:
    """Return CPU (percent of one core) and memory (MiB) of an idle program."""
    time.sleep(5.0 * options.scale)  # until the start is over
    cpu, begin = program.cpu, time.monotonic()
    time.sleep(max(_IDLE_AT_LEAST, _IDLE * options.scale))
    percent = 100 * (program.cpu - cpu) / (time.monotonic() - begin)
    return percent, program.rss / MIB


class Watcher:
    """A client that runs before the agent and watches its start.

    Args:
        domain: its ROS_DOMAIN_ID.
        further_actions: names of actions to wait for, beside those of the agent.
    """

    def __init__(self, domain: int, further_actions: Sequence[str] = ()) -> None:
        self._client = Client(domain)
        self._actions = [*(each.name for each in ACTIONS), *further_actions]
        self._connected = self._client.echo(Bool, "connected")

    def wait_started(self, *, connected: bool) -> None:
        """Wait until every endpoint is discovered and, if requested, the link is ready."""
        deadline = time.monotonic() + _START_TIMEOUT
        while not (self._all_discovered() and (self._link_ready() or not connected)):
            assert time.monotonic() < deadline, "timed out waiting for the endpoints"
            time.sleep(_POLL)

    def _link_ready(self) -> bool:
        return any(message.data for message in self._connected.messages)

    def _all_discovered(self) -> bool:
        node, path = self._client.node, self._client.path
        services = {name for name, _ in node.get_service_names_and_types()}
        topics = {name for name, _ in node.get_topic_names_and_types()}
        return (
            {path(each.name) for each in (*QUERIES, *COMMANDS)} <= services
            and {path(each.name) for each in TOPICS} <= topics
            and {path(f"{name}/_action/status") for name in self._actions} <= topics
        )

    def close(self) -> None:
        self._client.close()


def _wait_gone(domain: int) -> None:
    """Wait until the agent has disappeared from the ROS graph."""
    client = Client(domain)
    wait_until(
        lambda: "agent" not in client.node.get_node_names(), "the agent to go", _START_TIMEOUT
    )
    client.close()
