"""Compare the cost of each transport and encoding, measured in turn on the same machine.

scripts/bench --links                 print the table, medians of three repetitions
scripts/bench --links --docs          also write it to docs/speed.md
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Sequence

from benchmarks.measurements.calls import POSE_SPEED, SCAN, call_repeatedly, calling
from benchmarks.measurements.pushes import push_path
from benchmarks.options import LINKS, Options, make_parser, parse, repetitions, scale
from benchmarks.report.machine import describe_machine
from benchmarks.report.pages import write_part
from benchmarks.report.table import markdown
from woosh_robot_agent.testing import own_domain

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
    """Return all figures of one link."""
    with calling(domain) as caller, push_path(domain, options) as path:
        (agent,) = path.publishers
        pushes = path.push(100.0, options.samples(1000))
        calls = call_repeatedly(agent, caller, POSE_SPEED, options.samples(1000), options)
        scans = call_repeatedly(agent, caller, SCAN, options.samples(500), options)
    return {
        "service_rtt": calls.times.median,
        "service_rtt_p99": calls.times.p99,
        "service_cpu": calls.cpu,
        "push_latency": pushes.latency.median,
        "push_latency_p99": pushes.latency.p99,
        "push_cpu": pushes.cpu_per_push,
        "scan_rtt": scans.times.median,
        "scan_cpu": scans.cpu,
    }


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table."""
    given = parse(make_parser("links", __doc__), arguments)
    found: dict[str, list[dict[str, float]]] = {name: [] for name in LINKS}
    for repetition in range(repetitions(given)):
        for name, (transport, encoding) in LINKS.items():
            print(f"{repetition + 1}: {name}", file=sys.stderr, flush=True)
            with own_domain() as domain:
                options = Options(given.executor, scale(given), transport, encoding)
                found[name].append(measure(domain, options))
    medians = {
        name: {figure: statistics.median(each[figure] for each in runs) for figure in FIGURES}
        for name, runs in found.items()
    }
    table = markdown(
        ("", *medians),
        (
            (description, *(f"{each[figure]:.0f}" for each in medians.values()))
            for figure, description in FIGURES.items()
        ),
    )
    print(json.dumps(medians) if given.json else table)
    if given.docs:
        write_part("links", f"{describe_machine()}.\n\n{table}")
    return 0
