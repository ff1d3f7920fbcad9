"""Measure the transfer of a map of 20 MiB over each transport and encoding, relative to bare rclpy.

scripts/bench --maps                  print the table, medians of three repetitions
"""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.links import Columns, compare, comparison_table
from benchmarks.measurements.maps import MILLISECONDS, MapCost, Transfers, measure_cost
from benchmarks.options import Options, add_repetitions, make_parser, report

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


def measure(domain: int, options: Options) -> Columns:
    """Return all figures of one link in the column "", and those of the floor in `FLOOR`."""
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
    return {"": ours, FLOOR: floor}


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table."""
    parser = make_parser("maps", __doc__)
    add_repetitions(parser)
    given = parser.parse_args(arguments)
    found = compare(given, measure)
    found[FLOOR] = found.pop(FLOOR)  # make it the last column
    return report(given, found, lambda columns: comparison_table(columns, FIGURES))
