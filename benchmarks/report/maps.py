"""Measure the transfer of a map of 20 MiB over each transport and encoding, relative to bare rclpy.

scripts/bench --maps                  print the table, medians of three repetitions
scripts/bench --maps --docs           also write it to docs/speed.md
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Sequence

from benchmarks.measurements.maps import MILLISECONDS, MapCost, Transfers, measure_cost
from benchmarks.options import LINKS, Options, make_parser, parse, repetitions, scale
from benchmarks.report.machine import describe_machine
from benchmarks.report.pages import write_part
from benchmarks.report.table import markdown
from woosh_robot_agent.testing import own_domain

FIGURES = {
    "download_ratio": "download, median / bare rclpy",
    "download": "download, median, ms",
    "download_p99": "download, p99, ms",
    "download_cpu": "agent's CPU per download, ms",
    "download_memory": "agent's peak of memory in downloads, in sizes of the map",
    "upload_ratio": "upload, median / bare rclpy",
    "upload": "upload, median, ms",
    "upload_p99": "upload, p99, ms",
    "upload_cpu": "agent's CPU per upload, ms",
    "upload_memory": "agent's peak of memory in uploads, in sizes of the map",
    "velocity_idle": "cmd_vel to chassis, idle, median, ms",
    "velocity_idle_p99": "cmd_vel to chassis, idle, p99, ms",
    "velocity": "cmd_vel to chassis, during downloads, median, ms",
    "velocity_p99": "cmd_vel to chassis, during downloads, p99, ms",
}
FLOOR = "bare rclpy"
"""Title of the floor's column."""


def _transfers(name: str, transfers: Transfers) -> dict[str, float]:
    return {
        name: transfers.trips.times.median * MILLISECONDS,
        f"{name}_p99": transfers.trips.times.p99 * MILLISECONDS,
        f"{name}_cpu": transfers.trips.cpu * MILLISECONDS,
        f"{name}_memory": transfers.memory,
    }


def measure(domain: int, options: Options) -> tuple[dict[str, float], dict[str, float]]:
    """Return all figures of one link, and those of the floor beside it."""
    cost: MapCost = measure_cost(domain, options)
    ours: dict[str, float] = {}
    floor: dict[str, float] = {}
    for direction in ("Download", "Upload"):
        name = direction.lower()
        ours[f"{name}_ratio"] = cost.ratio(direction)
        ours |= _transfers(name, cost.agent[direction])
        floor |= _transfers(name, cost.floor[direction])
    for name, latency in (("velocity_idle", cost.idle_velocities), ("velocity", cost.velocities)):
        if latency is not None:
            ours[name] = latency.median * MILLISECONDS
            ours[f"{name}_p99"] = latency.p99 * MILLISECONDS
    return ours, floor


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table."""
    given = parse(make_parser("maps", __doc__), arguments)
    found: dict[str, list[dict[str, float]]] = {name: [] for name in (*LINKS, FLOOR)}
    for repetition in range(repetitions(given)):
        for name, (transport, encoding) in LINKS.items():
            print(f"{repetition + 1}: {name}", file=sys.stderr, flush=True)
            with own_domain() as domain:
                options = Options(given.executor, scale(given), transport, encoding)
                ours, floor = measure(domain, options)
            found[name].append(ours)
            found[FLOOR].append(floor)
    medians = {
        name: {
            figure: statistics.median(each[figure] for each in runs)
            for figure in FIGURES
            if figure in runs[0]
        }
        for name, runs in found.items()
    }
    table = markdown(
        ("", *medians),
        (
            (description, *(_cell(each.get(figure)) for each in medians.values()))
            for figure, description in FIGURES.items()
        ),
    )
    print(json.dumps(medians) if given.json else table)
    if given.docs:
        write_part("maps", f"{describe_machine()}.\n\n{table}")
    return 0


def _cell(value: float | None) -> str:
    return "" if value is None else f"{value:.0f}" if value >= 100 else f"{value:.3g}"
