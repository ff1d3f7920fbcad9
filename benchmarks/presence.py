"""What the agent costs while nothing happens, and how long it takes to be there."""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Iterator

from std_msgs.msg import Bool

from benchmarks.options import Measured, Options
from benchmarks.programs import Program, agent_command, echo_chassis, running
from tests.harness import Client, wait_until
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, QUERIES, TOPICS
from woosh_robot_agent.parameters import PARAMETERS
from woosh_robot_agent.standard.endpoints import STANDARD, Kind

_MIB = 1024 * 1024
_STARTS = 5
_LOOK_EVERY = 0.02
"""s between looks for endpoints: a look takes ms of a core that the start needs too."""
_KINDS = {Kind.SERVICE: "service", Kind.INPUT: "subscription", Kind.LATCHED: "latched"}


def entities() -> Iterator[str]:
    """All that the agent makes by default, as `benchmarks.floors.entities` takes it."""
    for service in (*QUERIES, *COMMANDS):
        yield f"service:{service.srv}:{service.name}:0"
    for topic in TOPICS:
        yield f"latched:{topic.msg}:{topic.name}:{topic.depth}"
    for action in ACTIONS:
        yield f"action:{action.action}:{action.name}:0"
    off = {each.name for each in PARAMETERS if each.initial is False}
    for entry in STANDARD:
        if entry.switch not in off:
            kind = _KINDS.get(entry.kind, "publisher")
            yield f"{kind}:{entry.type}:{entry.name}:{entry.depth}"


def _commands(port: int, options: Options) -> dict[str, list[str]]:
    return {
        "agent": agent_command(port, options),
        "floor": ["benchmarks.floors.entities", *entities()],
    }


def presence(domain: int, options: Options) -> Measured:
    """From exec until all is there, some times; then, of the last, what it takes to be idle."""
    starts: dict[str, list[float]] = {"agent": [], "floor": []}
    rss, cpu = {}, {}
    with echo_chassis(domain, options.transport) as (_, port):
        for turn in reversed(range(1 if options.smoke else _STARTS)):
            for name, command in _commands(port, options).items():
                watcher = Watcher(domain)
                with running(*command, domain=domain) as program:
                    watcher.wait_there(connected=name == "agent")
                    starts[name].append(time.monotonic() - program.started)
                    watcher.close()
                    if turn == 0:
                        cpu[name], rss[name] = _idle(program, options)
                gone(domain)
    ours, bare = (statistics.median(starts[name]) for name in ("agent", "floor"))
    return {
        "idle_rss": (rss["agent"] / rss["floor"], f"{rss['agent']:.1f} / {rss['floor']:.1f} MiB"),
        "idle_cpu": (cpu["agent"], f"{cpu['agent']:.2f} %, bare {cpu['floor']:.2f} %"),
        "startup": (ours / bare, f"{ours:.2f} / {bare:.2f} s"),
    }


def _idle(program: Program, options: Options) -> tuple[float, float]:
    """CPU in percent of a core and memory in MiB, with nobody subscribed."""
    threading.Event().wait(5.0 * options.scale)  # the start is over
    before, begun = program.cpu, time.monotonic()
    threading.Event().wait(20.0 * options.scale)
    percent = 100 * (program.cpu - before) / (time.monotonic() - begun)
    return percent, program.rss / _MIB


class Watcher:
    """A client that was there before the agent, and sees it come."""

    def __init__(self, domain: int) -> None:
        self._client = Client(domain)
        self._connected = self._client.echo(Bool, "connected")

    def wait_there(self, *, connected: bool) -> None:
        """Return when every endpoint of the table is discovered, and the link is there too."""
        deadline = time.monotonic() + 60.0
        while not (self._all_there() and (self._has_link() or not connected)):
            assert time.monotonic() < deadline, "timed out waiting for the endpoints"
            threading.Event().wait(_LOOK_EVERY)

    def _has_link(self) -> bool:
        return any(message.data for message in self._connected.messages)

    def _all_there(self) -> bool:
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


def gone(domain: int) -> None:
    """Return when nothing is left of the agent in the graph."""
    watcher = Client(domain)
    wait_until(lambda: "agent" not in watcher.node.get_node_names(), "the end of the agent", 60.0)
    watcher.close()
