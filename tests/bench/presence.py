"""What the agent costs while nothing happens, and how long it takes to be there."""

from __future__ import annotations

import statistics
import threading
import time
from typing import TYPE_CHECKING

from harness import Client, wait_until

from bench.programs import agent_command, echo_chassis, running
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, QUERIES, TOPICS

if TYPE_CHECKING:
    from bench.speed import Options

_MIB = 1024 * 1024


def idle(domain: int, options: Options) -> dict[str, tuple[float, str]]:
    """Memory and CPU, connected, nobody subscribed, the standard layer on."""
    with echo_chassis(domain, "--transport", options.transport) as (_, port):
        commands = {
            "agent": agent_command(port, options.executor, **options.link),
            "floor": ["bench.floors.entities", options.executor],
        }
        rss, cpu = {}, {}
        for name, command in commands.items():
            with running(*command, domain=domain) as program:
                discovered(domain)
                threading.Event().wait(3.0 * options.scale)  # the start is over
                before, begun = program.cpu, time.monotonic()
                threading.Event().wait(20.0 * options.scale)
                cpu[name] = 100 * (program.cpu - before) / (time.monotonic() - begun)
                rss[name] = program.rss / _MIB
    return {
        "idle_rss": (rss["agent"] / rss["floor"], f"{rss['agent']:.1f} / {rss['floor']:.1f} MiB"),
        "idle_cpu": (cpu["agent"], f"{cpu['agent']:.2f} %, bare {cpu['floor']:.2f} %"),
    }


def startup(domain: int, options: Options) -> dict[str, tuple[float, str]]:
    """From exec until a client sees all endpoints."""
    times: dict[str, list[float]] = {"agent": [], "floor": []}
    with echo_chassis(domain, "--transport", options.transport) as (_, port):
        commands = {
            "agent": agent_command(port, options.executor, **options.link),
            "floor": ["bench.floors.entities", options.executor],
        }
        for _ in range(options.count(5)):
            for name, command in commands.items():
                watcher = Client(domain)
                with running(*command, domain=domain) as program:
                    wait_until(lambda: all_there(watcher), "the endpoints", 60.0)  # noqa: B023
                    if name == "agent":
                        wait_connected(watcher)
                    times[name].append(time.monotonic() - program.started)
                watcher.close()
                gone(domain)
    agent, floor = (statistics.median(times[name]) for name in ("agent", "floor"))
    return {"startup": (agent / floor, f"{agent:.2f} / {floor:.2f} s")}


def all_there(watcher: Client) -> bool:
    """Whether every endpoint of the table is discovered."""
    node = watcher.node
    services = {name for name, _ in node.get_service_names_and_types()}
    topics = {name for name, _ in node.get_topic_names_and_types()}
    return (
        {watcher.path(each.name) for each in (*QUERIES, *COMMANDS)} <= services
        and {watcher.path(each.name) for each in TOPICS} <= topics
        and {watcher.path(f"{each.name}/_action/status") for each in ACTIONS} <= topics
    )


def wait_connected(watcher: Client) -> None:
    """Return when the agent has its link."""
    from std_msgs.msg import Bool

    watcher.echo(Bool, "connected").wait(lambda message: message.data)


def discovered(domain: int) -> None:
    """Return when a client sees all endpoints; it is gone then."""
    watcher = Client(domain)
    wait_until(lambda: all_there(watcher), "the endpoints", 60.0)
    watcher.close()


def gone(domain: int) -> None:
    """Return when nothing is left of the agent in the graph."""
    watcher = Client(domain)
    wait_until(lambda: "agent" not in watcher.node.get_node_names(), "the end of the agent", 60.0)
    watcher.close()
