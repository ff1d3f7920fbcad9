"""Measure how the cost of the VDA 5050 connector grows with the number of robots.

scripts/bench --fleet                 print the table
scripts/bench --fleet --robots 1 10   other numbers of robots

Simulated robots drive orders of 20 nodes each, and report a change once a second; all are vehicles
of one process at one broker. Measured are the time from such a push of the robot until the `state`
with it leaves the broker, the messages that were lost, and the CPU time and memory of the
connector. The simulated robots and the broker are processes of their own, whose CPU time is counted
apart. The exit status is 1 if a message is lost or an order is not driven.
"""

from __future__ import annotations

import argparse
import bisect
import contextlib
import json
import math
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho

from benchmarks.figures import Spread, markdown
from benchmarks.options import make_parser, report
from benchmarks.processes import MIB, Program, running
from benchmarks.programs.simulated_robots import CHARGES
from woosh_robot_agent.testing import own_domain, wait_until

ROBOTS = (1, 2, 5, 10, 20, 50, 100)
FIRST_SERIAL = 30001
"""Serial number of the first robot; the others follow."""
_PREFIX = "uagv/v2/Woosh"
_PER_SIMULATOR = 25
"""Maximum number of simulated robots in a process."""
_PERIOD = 1.0
"""Time between two changes that a robot reports, in seconds."""
_START = (4.23276472, -6.6727581, -0.255771846)
"""Where the simulated robots stand at first: x, y and heading."""
_RADIUS = 2.0
"""Radius of the circle on which the robots drive, in metres."""
_TIMEOUT = 300.0

Message = dict[str, Any]


@dataclass(frozen=True)
class Load:
    """What the robots do in a measurement.

    Attributes:
        nodes: number of nodes of each order.
        speed: simulated seconds per real second.
        seconds: minimum duration, in seconds.
        arguments: further arguments of the connector.
    """

    nodes: int = 20
    speed: float = 1.0
    seconds: float = 30.0
    arguments: tuple[str, ...] = ()


@dataclass(frozen=True)
class VehicleCost:
    """Result of a measurement.

    Attributes:
        robots: number of robots.
        latency: time from a push of the robot until the state with it leaves the broker.
        measured: number of pushes behind `latency`.
        unseen: number of pushes of which no state was seen.
        messages: number of messages of the vehicles.
        rate: messages of the vehicles per second.
        traffic: bytes of these messages per second.
        lost: number of messages that are missing according to their header ids.
        ended: number of orders that were driven to their last node.
        cpu: CPU time of the connector, in percent of a core.
        broker_cpu: CPU time of the broker, in percent of a core.
        simulator_cpu: CPU time of the simulated robots, in percent of a core.
        rss: resident memory of the connector, in MiB.
        idle_cpu: CPU time of the connector while the robots stand, in percent of a core.
    """

    robots: int
    latency: Spread
    measured: int
    unseen: int
    messages: int
    rate: float
    traffic: float
    lost: int
    ended: int
    cpu: float
    broker_cpu: float
    simulator_cpu: float
    rss: float
    idle_cpu: float


def mosquitto_path() -> str | None:
    """Return the path of the broker; None if it is not installed."""
    return shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")


@contextlib.contextmanager
def _broker() -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """Run a broker; yield its process and its port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    path = mosquitto_path()
    if path is None:
        raise SystemExit("mosquitto is not installed; install it, e.g. with apt-get")
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder, "mosquitto.conf")
        # Started by root, it would change its user, and could then not be ended.
        config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nuser root\n")
        with subprocess.Popen([path, "-c", str(config)], stderr=subprocess.DEVNULL) as process:
            try:
                wait_until(lambda: _listens(port), "the broker to listen", _TIMEOUT)
                yield process, port
            finally:
                process.terminate()


def _listens(port: int) -> bool:
    with contextlib.suppress(OSError):
        socket.create_connection(("127.0.0.1", port), 1.0).close()
        return True
    return False


def _cpu(process: subprocess.Popen[bytes]) -> float:
    """Return the CPU time of a process, in seconds."""
    return int(Path("/proc", str(process.pid), "schedstat").read_text().split()[0]) / 1e9


@dataclass
class _Master:
    """Fleet master: sends orders, and records all messages with their times."""

    port: int
    received: list[tuple[float, str, bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        self._client.on_connect = lambda client, *_: client.subscribe(f"{_PREFIX}/#", 0)
        self._client.on_message = self._on_message
        self._client.connect("127.0.0.1", self.port)
        self._client.loop_start()

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    def _on_message(self, client: paho.Client, data: Any, message: paho.MQTTMessage) -> None:
        self.received.append((time.monotonic(), message.topic, message.payload))

    def serials(self, topic: str) -> set[str]:
        """Return the serial numbers that have sent on a topic."""
        return {name.split("/")[3] for _, name, _ in self.received if name.endswith(topic)}

    def send_order(self, serial: int, nodes: int) -> None:
        """Send an order of some nodes on a circle."""
        message = {
            "headerId": 0,
            "timestamp": "2025-01-01T00:00:00.000Z",
            "version": "2.1.0",
            "manufacturer": "Woosh",
            "serialNumber": str(serial),
            **order(nodes),
        }
        self._client.publish(f"{_PREFIX}/{serial}/order", json.dumps(message))

    def last_states(self) -> dict[str, Message]:
        """Return the last state of each vehicle."""
        last = {name: payload for _, name, payload in self.received if name.endswith("/state")}
        return {name.split("/")[3]: json.loads(payload) for name, payload in last.items()}


def order(count: int) -> Message:
    """Return an order with some nodes on a circle, from where the robots stand."""
    x, y, heading = _START
    center_x, center_y = x - _RADIUS * math.sin(heading), y + _RADIUS * math.cos(heading)
    nodes: list[Message] = []
    for number in range(count):
        angle = heading - math.pi / 2 + 0.9 * math.tau * number / max(count - 1, 1)
        place = {
            "x": center_x + _RADIUS * math.cos(angle),
            "y": center_y + _RADIUS * math.sin(angle),
            "mapId": "wooshmap",
        }
        nodes.append(
            {
                "nodeId": f"n{number}",
                "sequenceId": 2 * number,
                "released": True,
                "nodePosition": place,
                "actions": [],
            }
        )
    edges = [
        {
            "edgeId": f"e{number}",
            "sequenceId": 2 * number + 1,
            "released": True,
            "startNodeId": start["nodeId"],
            "endNodeId": end["nodeId"],
            "actions": [],
        }
        for number, (start, end) in enumerate(pairwise(nodes))
    ]
    return {"orderId": "order", "orderUpdateId": 0, "nodes": nodes, "edges": edges}


def measure(robots: int, load: Load) -> VehicleCost:
    """Measure the cost with a number of robots in one process of the connector."""
    with contextlib.ExitStack() as stack:
        domain = stack.enter_context(own_domain())
        broker, broker_port = stack.enter_context(_broker())
        simulators: list[Program] = []
        for first in range(0, robots, _PER_SIMULATOR):
            count = min(_PER_SIMULATOR, robots - first)
            command = ("--count", count, "--first", FIRST_SERIAL + first, "--speed", load.speed)
            program = running(
                "benchmarks.programs.simulated_robots", *map(str, command), domain=domain
            )
            simulators.append(stack.enter_context(program))
        ports = [port for program in simulators for port in program.receive()]
        master = _Master(broker_port)
        stack.callback(master.close)
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        file = _robots_file(Path(folder, "robots.yaml"), ports)
        connector = stack.enter_context(
            running(
                *("woosh_robot_agent.vda5050", "--robots", str(file)),
                *("--broker", f"mqtt://127.0.0.1:{broker_port}"),
                *("--state-folder", str(Path(folder, "state")), *load.arguments),
                domain=domain,
            )
        )
        serials = [FIRST_SERIAL + number for number in range(robots)]
        wait_until(
            lambda: len(master.serials("/state")) == robots, "states of all vehicles", _TIMEOUT
        )
        return _measure(master, connector, broker, simulators, serials, load)


def _robots_file(path: Path, ports: list[int]) -> Path:
    names = [f"r{number}" for number, _ in enumerate(ports)]
    sections: dict[str, Any] = {"/**": {"robots": names, "ip": "127.0.0.1"}}
    sections |= {f"/{name}/agent": {"port": port} for name, port in zip(names, ports, strict=True)}
    content = {node: {"ros__parameters": each} for node, each in sections.items()}
    path.write_text(json.dumps(content))  # JSON is valid YAML
    return path


def _measure(
    master: _Master,
    connector: Program,
    broker: subprocess.Popen[bytes],
    simulators: list[Program],
    serials: list[int],
    load: Load,
) -> VehicleCost:
    cpu, begin = connector.cpu, time.monotonic()
    time.sleep(min(load.seconds, 5.0))  # at rest
    idle = 100.0 * (connector.cpu - cpu) / (time.monotonic() - begin)

    before = (connector.cpu, _cpu(broker), sum(each.cpu for each in simulators))
    begin, first = time.monotonic(), len(master.received)
    for program in simulators:
        program.send("start", _PERIOD)
    for serial in serials:
        master.send_order(serial, load.nodes)
    last = f"n{load.nodes - 1}"
    deadline = begin + _TIMEOUT
    while time.monotonic() < deadline:
        time.sleep(1.0)
        states = master.last_states().values()
        if time.monotonic() > begin + load.seconds and all(
            state["lastNodeId"] == last and not state["nodeStates"] for state in states
        ):
            break
    for program in simulators:
        program.send("stop")
    pushes = [push for program in simulators for push in program.receive()]
    after = (connector.cpu, _cpu(broker), sum(each.cpu for each in simulators))
    took = time.monotonic() - begin
    cpu, broker_cpu, simulator_cpu = (
        100.0 * (b - a) / took for a, b in zip(before, after, strict=True)
    )
    time.sleep(1.0)  # the last states are still on their way
    messages, driving = (
        [each for each in received if not each[1].endswith("/order")]
        for received in (master.received, master.received[first:])
    )
    latencies = _latencies(pushes, messages)
    states = master.last_states().values()
    return VehicleCost(
        robots=len(serials),
        latency=Spread.of(latencies),
        measured=len(latencies),
        unseen=len(pushes) - len(latencies),
        messages=len(driving),
        rate=len(driving) / took,
        traffic=sum(len(payload) for *_, payload in driving) / took,
        lost=_lost(messages),
        ended=sum(state["lastNodeId"] == last and not state["nodeStates"] for state in states),
        cpu=cpu,
        broker_cpu=broker_cpu,
        simulator_cpu=simulator_cpu,
        rss=connector.rss / MIB,
        idle_cpu=idle,
    )


def _latencies(
    pushes: list[tuple[int, int, float]], messages: list[tuple[float, str, bytes]]
) -> list[float]:
    """Return the times from each push to the first state with its charge, in seconds."""
    seen: dict[tuple[int, int], list[float]] = defaultdict(list)
    for when, name, payload in messages:
        if name.endswith("/state"):
            charge = round(json.loads(payload)["batteryState"]["batteryCharge"])
            seen[int(name.split("/")[3]), charge].append(when)
    found = []
    for robot, charge, pushed in pushes:
        times = seen[robot, charge]
        index = bisect.bisect_left(times, pushed)
        # the same charge comes again after `len(CHARGES)` periods
        if index < len(times) and times[index] < pushed + len(CHARGES) * _PERIOD / 2:
            found.append(times[index] - pushed)
    return found


def _lost(messages: list[tuple[float, str, bytes]]) -> int:
    """Return the number of messages that are missing between the first and the last of a topic."""
    ids: dict[str, list[int]] = defaultdict(list)
    for _, name, payload in messages:
        ids[name].append(json.loads(payload)["headerId"])
    return sum(each[-1] - each[0] + 1 - len(set(each)) for each in ids.values())


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table."""
    parser = make_parser("fleet", __doc__)
    parser.add_argument("--robots", type=int, nargs="+", default=ROBOTS, metavar="N")
    parser.add_argument(
        "--connector",
        nargs=argparse.REMAINDER,
        default=[],
        metavar="OPTION",
        help="further options of the connector; the last option of this command",
    )
    given = parser.parse_args(arguments)
    if min(given.robots) < 1:
        parser.error("--robots must be at least 1")
    options = tuple(given.connector)
    load = Load(4, 20.0, 2.0, options) if given.smoke else Load(arguments=options)
    found = []
    for robots in (2,) if given.smoke else given.robots:
        print(f"{robots} robots", file=sys.stderr, flush=True)
        found.append(asdict(measure(robots, load)))
    return report(given, found, _table, excess)


def excess(found: Sequence[Message]) -> list[str]:
    """Return the lost messages and missing orders, as text."""
    problems = []
    for each in found:
        if each["lost"]:
            problems.append(f"{each['robots']} robots: {each['lost']} messages are lost")
        if each["ended"] != each["robots"]:
            problems.append(f"{each['robots']} robots: {each['ended']} orders were driven")
    return problems


def _table(found: Sequence[Message]) -> str:
    header = (
        "robots",
        "state latency, median, ms",
        "state latency, p99, ms",
        "messages/s",
        "kB/s",
        "lost",
        "orders driven",
        "connector's CPU, % of a core",
        "of it per robot",
        "at rest",
        "connector's memory, MiB",
        "broker's CPU, %",
        "simulated robots' CPU, %",
    )
    rows = [
        (
            each["robots"],
            f"{each['latency']['median'] / 1000:.1f}",
            f"{each['latency']['p99'] / 1000:.1f}",
            f"{each['rate']:.1f}",
            f"{each['traffic'] / 1000:.1f}",
            f"{each['lost']} of {each['messages']}",
            each["ended"],
            f"{each['cpu']:.1f}",
            f"{each['cpu'] / each['robots']:.2f}",
            f"{each['idle_cpu']:.1f}",
            f"{each['rss']:.0f}",
            f"{each['broker_cpu']:.1f}",
            f"{each['simulator_cpu']:.0f}",
        )
        for each in found
    ]
    return markdown(header, rows, "r" * len(header))
