"""Compare the cost of each transport and encoding, measured in turn on the same machine.

scripts/bench --links                 print the table, medians of three repetitions
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence

from benchmarks.figures import markdown
from benchmarks.measurements.calls import POSE_SPEED, SCAN, call_repeatedly, calling
from benchmarks.measurements.pushes import push_path
from benchmarks.options import (
    LINKS,
    Options,
    add_repetitions,
    make_parser,
    measure_each,
    repetitions,
    report,
)
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
Columns = dict[str, dict[str, float]]
"""Figures of each column of a table: of each kind of link, and of a floor."""


def measure(domain: int, options: Options) -> Columns:
    """Return all figures of one link, in the column ""."""
    with calling(domain) as caller, push_path(domain, options) as path:
        (agent,) = path.publishers
        pushes = path.push(100.0, options.samples(1000))
        calls = call_repeatedly(agent, caller, POSE_SPEED, options.samples(1000), options)
        scans = call_repeatedly(agent, caller, SCAN, options.samples(500), options)
    figures = {
        "service_rtt": calls.times.median,
        "service_rtt_p99": calls.times.p99,
        "service_cpu": calls.cpu,
        "push_latency": pushes.latency.median,
        "push_latency_p99": pushes.latency.p99,
        "push_cpu": pushes.cpu_per_push,
        "scan_rtt": scans.times.median,
        "scan_cpu": scans.cpu,
    }
    return {"": figures}


def compare(given: argparse.Namespace, measure_link: Callable[[int, Options], Columns]) -> Columns:
    """Measure every kind of link in turn; return the medians of the repetitions, by column.

    Args:
        given: options of the command line.
        measure_link: measures one link. The column "" is that of the link.
    """
    found: dict[str, list[dict[str, float]]] = {}
    for repetition in range(repetitions(given)):

        def measure_one(name: str, repetition: int = repetition) -> Columns:
            print(f"{repetition + 1}: {name}", file=sys.stderr, flush=True)
            with own_domain() as domain:
                return measure_link(domain, Options(given.smoke, *LINKS[name]))

        for name, columns in zip(LINKS, measure_each(given, measure_one, LINKS), strict=True):
            for column, figures in columns.items():
                found.setdefault(column or name, []).append(figures)
    return {
        column: {name: statistics.median(run[name] for run in runs) for name in runs[0]}
        for column, runs in found.items()
    }


def comparison_table(columns: Columns, figures: Mapping[str, str]) -> str:
    """Return a Markdown table with a row for each figure."""
    return markdown(
        ("", *columns),
        (
            (description, *(_cell(each.get(name)) for each in columns.values()))
            for name, description in figures.items()
        ),
    )


def _cell(value: float | None) -> str:
    return "" if value is None else f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table."""
    parser = make_parser("links", __doc__)
    add_repetitions(parser)
    given = parser.parse_args(arguments)
    return report(given, compare(given, measure), lambda found: comparison_table(found, FIGURES))
