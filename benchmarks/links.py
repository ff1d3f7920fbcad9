"""What each way to connect costs, side by side, by turns: so that one can choose by figures.

scripts/bench --links                 the table, medians of three repetitions
scripts/bench --links --docs          puts it into docs/speed.md
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Sequence

from benchmarks import machine, pages
from benchmarks.calls import POSE_SPEED, SCAN, calling, trips
from benchmarks.options import Options, parsed, parser, repetitions, scale
from benchmarks.pushes import line
from tests.harness import own_domain

LINKS = {
    "WebSocket, JSON": ("websocket", "json"),
    "WebSocket, protobuf": ("websocket", "protobuf"),
    "TCP, protobuf": ("tcp", "protobuf"),
}
FIGURES = {
    "service_rtt": "service call, median, µs",
    "service_rtt_p99": "service call, p99, µs",
    "service_cpu": "agent's CPU per call, µs",
    "push_latency": "push to subscriber at 100 Hz, median, µs",
    "push_latency_p99": "push to subscriber at 100 Hz, p99, µs",
    "push_cpu": "agent's CPU per push at 100 Hz, µs",
    "scan_rtt": "call of robot/ScannerData, 1080 beams, median, µs",
    "scan_cpu": "agent's CPU per scan, µs",
}


def measure(domain: int, options: Options) -> dict[str, float]:
    """All figures of one link."""
    with calling(domain) as caller, line(domain, options) as made:
        (agent,) = made.publishers
        pushed = made.push(100.0, options.count(1000))
        called = trips(agent, caller, POSE_SPEED, options.count(1000), options)
        scanned = trips(agent, caller, SCAN, options.count(500), options)
    return {
        "service_rtt": called.times.median,
        "service_rtt_p99": called.times.p99,
        "service_cpu": called.cpu,
        "push_latency": pushed.latency.median,
        "push_latency_p99": pushed.latency.p99,
        "push_cpu": pushed.cpu_each,
        "scan_rtt": scanned.times.median,
        "scan_cpu": scanned.cpu,
    }


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table."""
    given = parsed(parser("links", __doc__), arguments)
    found: dict[str, list[dict[str, float]]] = {name: [] for name in LINKS}
    for repetition in range(repetitions(given)):
        for name, (transport, encoding) in LINKS.items():
            print(f"{repetition + 1}: {name}", file=sys.stderr, flush=True)
            with own_domain() as domain:
                options = Options(given.executor, scale(given), transport, encoding)
                found[name].append(measure(domain, options))
    medians = {
        name: {figure: statistics.median(each[figure] for each in rows) for figure in FIGURES}
        for name, rows in found.items()
    }
    if given.json:
        print(json.dumps(medians))
    else:
        print(table(medians))
    if given.docs:
        pages.write("links", f"{machine.described()}.\n\n{table(medians)}")
    return 0


def table(medians: dict[str, dict[str, float]]) -> str:
    """The links in Markdown, side by side."""
    rows = [f"| | {' | '.join(medians)} |", "| --- |" + " --- |" * len(medians)]
    for figure, what in FIGURES.items():
        rows.append(
            f"| {what} | {' | '.join(f'{each[figure]:.0f}' for each in medians.values())} |"
        )
    return "\n".join(rows)
