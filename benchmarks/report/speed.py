"""Measure the cost of the agent relative to floors: programs that do only what is necessary.

scripts/bench --speed                 print all figures, medians of three repetitions
scripts/bench --speed --json          print one JSON object instead of the table
scripts/bench --speed --only push_cpu convert_pose
scripts/bench --speed --smoke         run for seconds, to check that the benchmark works
scripts/bench --speed --docs          also write the table to docs/speed.md
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from benchmarks.measurements import (
    calls,
    conversions,
    fleet,
    fleet_end,
    goals,
    large_pushes,
    maps,
    presence,
    pushes,
    rosbridge,
    scans,
    stops,
    velocities,
)
from benchmarks.measurements.samples import Measured
from benchmarks.options import Options, make_parser, parse, repetitions, scale
from benchmarks.report.machine import describe_machine
from benchmarks.report.pages import write_part
from benchmarks.report.results import Results, Target, results_table
from woosh_robot_agent.testing import own_domain

TARGETS = {
    "service_rtt": Target(2.0, 1.5, "median of a service call / (bare service + bare WebSocket)"),
    "service_rtt_p99": Target(3.0, 2.0, "the same at p99"),
    "service_cpu": Target(2.0, 1.3, "agent's CPU per call / (bare server + bare client)"),
    "concurrent": Target(0.93, 0.96, "10 concurrent calls of 50 ms: throughput / ideal", True),
    "push_latency": Target(1.1, 1.05, "push to subscriber at 100 Hz / bare publish"),
    "push_cpu": Target(1.2, 1.1, "agent's CPU per push at 100 Hz / bare publish"),
    "push_max": Target(0.8, 0.9, "highest rate without loss / bare publish's", True),
    "large_push": Target(
        20.0, 10.0, "ms for which the link thread is held at most, with two pushes of 2 MB a second"
    ),
    "cmd_vel_latency": Target(1.3, 1.1, "cmd_vel at 20 Hz to the chassis / bare subscriber"),
    "cmd_vel_cpu": Target(1.5, 1.2, "agent's CPU per cmd_vel at 20 Hz / bare subscriber"),
    "stop_latency": Target(
        20.0, 5.0, "ms from a call of `stop` to the zero at the chassis, p99, amid 50 other calls"
    ),
    "goal_rtt": Target(
        2.0, 1.5, "goal to the chassis, and last report to the result / bare action server"
    ),
    "scan_cpu": Target(1.5, 1.2, "agent's CPU per scan of 1080 beams at 10 Hz / bare publish"),
    "convert_pose": Target(1 / 8, 1 / 15, "PoseSpeed, JSON to ROS / ParseDict and reflection"),
    "convert_scan": Target(1 / 15, 1 / 25, "the same for a scan of 1080 beams"),
    "convert_info": Target(1 / 6, 1 / 12, "the same for a full RobotInfo"),
    "map_download": Target(
        2.0, 1.5, "a map of 20 MiB, from the chassis to a client / bare service"
    ),
    "map_upload": Target(3.0, 2.0, "the same map, from a client to the chassis / bare service"),
    "idle_rss": Target(1.35, 1.15, "resident memory / a node with the same entities"),
    "idle_cpu": Target(1.0, 0.3, "percent of a core, connected and unused"),
    "startup": Target(
        1.4, 1.2, "start to connected and discovered / a node with the same entities"
    ),
    "fleet_end": Target(3.0, 1.5, "seconds until a process with 20 robots has ended"),
    "fleet": Target(None, 60, "robots served at 20 Hz each, in the better of two ways", True),
    "rosbridge": Target(
        None, 1.0, "calls, and pushes at 100 Hz / the same through rosbridge, the worst ratio"
    ),
}
"""All figures, by name. `rosbridge` is measured only where it is installed."""

Measure = Callable[[int, Options], Measured]
"""Measures some figures in a ROS domain."""
MEASUREMENTS: tuple[tuple[Measure, tuple[str, ...]], ...] = (
    (calls.measure, ("service_rtt", "service_rtt_p99", "service_cpu", "concurrent")),
    (pushes.measure, ("push_latency", "push_cpu", "push_max")),
    (large_pushes.measure, ("large_push",)),
    (velocities.measure, ("cmd_vel_latency", "cmd_vel_cpu")),
    (stops.measure, ("stop_latency",)),
    (goals.measure, ("goal_rtt",)),
    (scans.measure, ("scan_cpu",)),
    (conversions.measure, ("convert_pose", "convert_scan", "convert_info")),
    (maps.measure, ("map_download", "map_upload")),
    (presence.measure, ("idle_rss", "idle_cpu", "startup")),
    (fleet_end.measure, ("fleet_end",)),
    (fleet.measure, ("fleet",)),
    (rosbridge.measure, ("rosbridge",)),
)
"""Measurements, each with the names of its figures."""
_SMOKE_THREADS = 3
"""Number of measurements at a time if their figures mean nothing. Most of the time they wait."""


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table.

    Returns:
        The exit status: 1 if a figure of `--only` cannot be measured. Otherwise it is 0, also if a
        figure is not reached, because machines differ too much.
    """
    parser = make_parser("speed", __doc__)
    parser.add_argument(
        "--only", nargs="+", choices=TARGETS, default=list(TARGETS), help="figures to measure"
    )
    parser.add_argument(
        "--transport", default="websocket", choices=("websocket", "tcp"), help="of the link"
    )
    parser.add_argument(
        "--encoding", default="json", choices=("json", "protobuf"), help="of the link"
    )
    given = parse(parser, arguments)
    default_link = (given.transport, given.encoding) == ("websocket", "json")
    if given.docs and not (default_link and set(given.only) == set(TARGETS) and given.repeat >= 3):
        parser.error("--docs needs all figures, at least three repetitions and the default link")
    results = _measure(
        Options(given.executor, scale(given), given.transport, given.encoding),
        repetitions(given),
        given.only,
    )
    without_rosbridge = "rosbridge" in given.only and "rosbridge" not in results.values
    if without_rosbridge:
        print(
            "rosbridge was not measured: install and source ros-$ROS_DISTRO-rosbridge-server",
            file=sys.stderr,
        )
    table = results_table(results, TARGETS)
    if given.json:
        print(json.dumps(results.medians(TARGETS)))
    else:
        print(table)
    if given.docs:
        write_part("figures", f"{describe_machine()}; executor `{given.executor}`.\n\n{table}")
    return 1 if without_rosbridge and len(given.only) < len(TARGETS) else 0


def _measure(options: Options, repeat: int, only: Sequence[str]) -> Results:
    """Return the requested figures, and those that are measured together with them."""
    wanted = [each for each in MEASUREMENTS if set(each[1]) & set(only)]
    results = Results()
    for repetition in range(repeat):

        def run(measurement: tuple[Measure, tuple[str, ...]], number: int = repetition) -> Measured:
            measure, names = measurement
            print(f"{number + 1}: {', '.join(names)}", file=sys.stderr, flush=True)
            with own_domain() as domain:
                return measure(domain, options)

        if options.smoke:
            # the outer domain keeps the variables set, which each inner one resets at its end
            with own_domain(), ThreadPoolExecutor(_SMOKE_THREADS) as pool:
                found = list(pool.map(run, wanted))
        else:
            found = list(map(run, wanted))
        for measured in found:
            results.add(measured)
    return results
