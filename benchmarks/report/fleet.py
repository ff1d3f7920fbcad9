"""Measure how the cost of the VDA 5050 connector grows with the number of robots.

scripts/bench --fleet                 print the table
scripts/bench --fleet --docs          also write table and plot to docs/ (needs matplotlib)
scripts/bench --fleet --robots 1 10   other numbers of robots

Each robot drives an order of 20 nodes and reports a change once a second; all are vehicles of one
process at one broker. The exit status is 1 if a message is lost or an order is not driven.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.measurements.vehicles import Load, VehicleCost, mosquitto_path, vehicles
from benchmarks.report.curves import Point, Sweep
from benchmarks.report.machine import describe_machine
from benchmarks.report.pages import DOCS, write_part
from benchmarks.report.table import markdown

ROBOTS = (1, 2, 5, 10, 20, 50, 100)
PAGE = DOCS / "vda5050.md"
_SWEEP = Sweep(
    "robots",
    "CPU of the connector, % of a core",
    "VDA 5050 connector: orders of 20 nodes, a change per robot and second",
    lambda options: {},
)


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(
        prog="scripts/bench --fleet",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--robots", type=int, nargs="+", default=ROBOTS, metavar="N")
    parser.add_argument("--json", action="store_true", help="print one JSON object, not a table")
    parser.add_argument(
        "--smoke", action="store_true", help="run for seconds, only to see that it works"
    )
    parser.add_argument("--docs", action="store_true", help=f"write the results to {PAGE.name}")
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
    if given.docs and given.smoke:
        parser.error("--docs cannot be combined with --smoke, whose figures mean nothing")
    if given.docs:
        # imported before the measurement, so that a missing matplotlib is noticed at once
        from benchmarks.report import plots
    extra = tuple(given.connector)
    load = Load(nodes=4, speed=20.0, seconds=2.0, arguments=extra)
    found = []
    for robots in (1, 2) if given.smoke else given.robots:
        print(f"{robots} robots", file=sys.stderr, flush=True)
        found.append(vehicles(robots, load if given.smoke else Load(arguments=extra)))
    table = _table(found)
    print(json.dumps([asdict(each) for each in found]) if given.json else table)
    if given.docs:
        machine = f"{describe_machine()}, {_broker_version()}"
        points = [Point.of(each.robots, each.cpu, each.latency) for each in found]
        plots.draw(DOCS / "vda5050_fleet.svg", _SWEEP, {"connector": points}, machine)
        write_part("fleet", f"![robots](vda5050_fleet.svg)\n\n{machine}.\n\n{table}", PAGE)
    problems = excess(found)
    for problem in problems:
        print(f"exceeded: {problem}", file=sys.stderr)
    return int(bool(problems))


def excess(found: Sequence[VehicleCost]) -> list[str]:
    """Return what must not be."""
    problems = []
    for each in found:
        if each.lost:
            problems.append(f"{each.robots} robots: {each.lost} messages are lost")
        if each.ended != each.robots:
            problems.append(f"{each.robots} robots: {each.ended} orders were driven to their end")
    return problems


def _table(found: Sequence[VehicleCost]) -> str:
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
            each.robots,
            f"{each.latency.median / 1000:.1f}",
            f"{each.latency.p99 / 1000:.1f}",
            f"{each.rate:.1f}",
            f"{each.traffic / 1000:.1f}",
            f"{each.lost} of {each.messages}",
            each.ended,
            f"{each.cpu:.1f}",
            f"{each.cpu / each.robots:.2f}",
            f"{each.idle_cpu:.1f}",
            f"{each.rss:.0f}",
            f"{each.broker_cpu:.1f}",
            f"{each.simulator_cpu:.0f}",
        )
        for each in found
    ]
    return markdown(header, rows, "r" * len(header))


def _broker_version() -> str:
    """Return the name and version of the broker."""
    path = mosquitto_path()
    assert path is not None
    text = subprocess.run([Path(path), "-h"], capture_output=True, text=True, check=False).stdout
    return text.partition("\n")[0].replace("version ", "")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
