"""Measure the cost of the agent relative to floors: programs that do only what is necessary.

scripts/bench --speed                 print all figures, medians of three repetitions
scripts/bench --speed --json          print one JSON object instead of the table
scripts/bench --speed --only push_cpu convert_pose
scripts/bench --speed --smoke         run for seconds, to check that the benchmark works

Each module in `measurements/` measures a group of figures, and has their targets.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from functools import partial

from benchmarks.figures import Measured, Results, Target
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
from benchmarks.options import (
    Options,
    add_repetitions,
    make_parser,
    measure_each,
    repetitions,
)
from woosh_robot_agent.testing import own_domain

Measure = Callable[[int, Options], Measured]
"""Measures some figures in a ROS domain."""
Group = tuple[Measure, dict[str, Target]]
"""Figures that are measured together, with their targets."""
GROUPS: tuple[Group, ...] = (
    (calls.measure, calls.FIGURES),
    (pushes.measure, pushes.FIGURES),
    (large_pushes.measure, large_pushes.FIGURES),
    (velocities.measure, velocities.FIGURES),
    (stops.measure, stops.FIGURES),
    (goals.measure, goals.FIGURES),
    (goals.measure_nav2, goals.NAV2_FIGURES),
    (scans.measure, scans.FIGURES),
    (conversions.measure, conversions.FIGURES),
    (maps.measure, maps.FIGURES),
    (presence.measure, presence.FIGURES),
    (presence.measure_nav2, presence.NAV2_FIGURES),
    (fleet_end.measure, fleet_end.FIGURES),
    (fleet.measure, fleet.FIGURES),
    (rosbridge.measure, rosbridge.FIGURES),
)
TARGETS = {name: target for _, figures in GROUPS for name, target in figures.items()}


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table.

    Returns:
        The exit status: 1 if a figure of `--only` cannot be measured. Otherwise it is 0, also if a
        figure is not reached, because machines differ too much.
    """
    parser = make_parser("speed", __doc__)
    add_repetitions(parser)
    parser.add_argument(
        "--only", nargs="+", choices=TARGETS, default=list(TARGETS), help="figures to measure"
    )
    given = parser.parse_args(arguments)
    results = _measure(given)
    without_rosbridge = "rosbridge" in given.only and "rosbridge" not in results.values
    if without_rosbridge:
        print(
            "rosbridge was not measured: install and source ros-$ROS_DISTRO-rosbridge-server",
            file=sys.stderr,
        )
    print(json.dumps(results.medians(TARGETS)) if given.json else results.table(TARGETS))
    return 1 if without_rosbridge and len(given.only) < len(TARGETS) else 0


def _measure(given: argparse.Namespace) -> Results:
    """Return the requested figures, and those that are measured together with them."""
    wanted = [group for group in GROUPS if set(group[1]) & set(given.only)]
    results = Results()
    for repetition in range(repetitions(given)):
        run = partial(_run, repetition, Options(given.smoke))
        for measured in measure_each(given, run, wanted):
            results.add(measured)
    return results


def _run(repetition: int, options: Options, group: Group) -> Measured:
    """Measure a group of figures in a ROS domain of its own."""
    measure, names = group
    print(f"{repetition + 1}: {', '.join(names)}", file=sys.stderr, flush=True)
    with own_domain() as domain:
        return measure(domain, options)
