"""Cost of an idle agent, and its start-up time."""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Iterator

from std_msgs.msg import Bool

from benchmarks.figures import Measured, Target
from benchmarks.options import Options
from benchmarks.processes import MIB, Program, agent_command, running, running_chassis
from tests.harness import Client
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, QUERIES, TOPICS
from woosh_robot_agent.ros.standard.endpoints import STANDARD, Kind
from woosh_robot_agent.testing import wait_until

FIGURES = {
    "idle_rss": Target(1.35, 1.15, "resident memory / a node with the same entities"),
    "idle_cpu": Target(1.0, 0.3, "percent of a core, connected and unused"),
    "startup": Target(
        1.4, 1.2, "start to connected and discovered / a node with the same entities"
    ),
}
_STARTS = 5
"""Number of starts; the figure is their median."""
_START_TIMEOUT = 60.0
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
        if entry.part != "tf":
            kind = _KINDS.get(entry.kind, "publisher")
            yield f"{kind}:{entry.type}:{entry.name}:{entry.depth}"


def floor_command(nodes: int) -> list[str]:
    """Return module and arguments of the floor with a number of nodes."""
    return ["benchmarks.floors.entities", str(nodes), *entities()]


def _commands(port: int, options: Options) -> dict[str, list[str]]:
    return {
        "agent": agent_command(port, options),
        "floor": floor_command(1),
    }


def measure(domain: int, options: Options) -> Measured:
    """Measure several starts of agent and floor in turn, then both while idle."""
    starts: dict[str, list[float]] = {"agent": [], "floor": []}
    rss, cpu = {}, {}
    with running_chassis(domain) as (_, port):
        for turn in reversed(range(1 if options.smoke else _STARTS)):
            for name, command in _commands(port, options).items():
                watcher = Watcher(domain)
                with running(*command, domain=domain) as program:
                    watcher.wait_started(connected=name == "agent")
                    starts[name].append(time.monotonic() - program.started)
                    watcher.close()
                    if turn == 0:
                        cpu[name], rss[name] = _idle(program, options)
                _wait_gone(domain)
    ours, floor = (statistics.median(starts[name]) for name in ("agent", "floor"))
    return {
        "idle_rss": (rss["agent"] / rss["floor"], f"{rss['agent']:.1f} / {rss['floor']:.1f} MiB"),
        "idle_cpu": (cpu["agent"], f"{cpu['agent']:.2f} %, floor {cpu['floor']:.2f} %"),
        "startup": (ours / floor, f"{ours:.2f} / {floor:.2f} s"),
    }


def _idle(program: Program, options: Options) -> tuple[float, float]:
    """Return CPU (percent of one core) and memory (MiB) of an idle program."""
    threading.Event().wait(5.0 * options.scale)  # until the start is over
    cpu, begin = program.cpu, time.monotonic()
    threading.Event().wait(max(_IDLE_AT_LEAST, _IDLE * options.scale))
    percent = 100 * (program.cpu - cpu) / (time.monotonic() - begin)
    return percent, program.rss / MIB


class Watcher:
    """A client that runs before the agent and watches its start."""

    def __init__(self, domain: int) -> None:
        self._client = Client(domain)
        self._connected = self._client.echo(Bool, "connected")

    def wait_started(self, *, connected: bool) -> None:
        """Wait until every endpoint is discovered and, if requested, the link is ready."""
        deadline = time.monotonic() + _START_TIMEOUT
        while not (self._all_discovered() and (self._link_ready() or not connected)):
            assert time.monotonic() < deadline, "timed out waiting for the endpoints"
            threading.Event().wait(_POLL)

    def _link_ready(self) -> bool:
        return any(message.data for message in self._connected.messages)

    def _all_discovered(self) -> bool:
        node, path = self._client.node, self._client.path
        services = {name for name, _ in node.get_service_names_and_types()}
        topics = {name for name, _ in node.get_topic_names_and_types()}
        return (
            {path(each.name) for each in (*QUERIES, *COMMANDS)} <= services
            and {path(each.name) for each in TOPICS} <= topics
            and {path(f"{each.name}/_action/status") for each in ACTIONS} <= topics
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
