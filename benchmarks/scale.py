"""Measure how cost grows with the number of robots, the rate of pushes and the size of a scan.

scripts/bench --scale                 print the tables, medians of three repetitions
scripts/bench --scale --only rates    only one of them
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass

from benchmarks.figures import Spread, markdown
from benchmarks.measurements.calls import SCAN, call_repeatedly, calling
from benchmarks.measurements.fleet import WAYS, Fleet, served
from benchmarks.measurements.pushes import PushPath, push_path
from benchmarks.options import (
    Options,
    add_repetitions,
    make_parser,
    measure_each,
    repetitions,
    report,
)
from benchmarks.processes import running_agent, running_chassis
from woosh_robot_agent.testing import own_domain

ROBOTS = (1, 2, 5, 10, 15, 20, 30, 40, 60)
RATES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)
BEAMS = (360, 720, 1080, 2000, 5000, 10_000, 20_000)
_DURATION = 5.0


@dataclass(frozen=True)
class Point:
    """Cost at one size.

    Attributes:
        size: number of robots, rate in Hz, or number of beams.
        cpu: CPU of the agents: percent of one core or, for scans, milliseconds per call.
        median: median latency, in milliseconds.
        p99: 99th percentile of the latency, in milliseconds.
    """

    size: float
    cpu: float
    median: float
    p99: float

    @classmethod
    def of(cls, size: float, cpu: float, times: Spread) -> Point:
        return cls(size, cpu, times.median / 1000, times.p99 / 1000)


Curves = dict[str, list[Point]]
"""Points of each curve, by the curve's name."""


def robots(options: Options) -> Curves:
    """Vary the number of robots, for both ways to run them, up to the number that is served."""
    curves: Curves = {}
    for way, per_process in WAYS.items():
        points = curves.setdefault(way, [])
        with Fleet(options, per_process=per_process) as fleet:
            for count in ROBOTS[:1] if options.smoke else ROBOTS:
                fleet.grow(count - fleet.robots)
                run = fleet.push()
                points.append(Point.of(count, run.percent(run.cpu), run.latency))
                if not served(run) and not options.smoke:
                    break
    return curves


def rates(options: Options) -> Curves:
    """Vary the rate of pushes, for the agent with its default odom and for the floor."""
    curves: Curves = {}
    for name, floor in (("agent", False), ("bare publish", True)):
        with own_domain() as domain, push_path(domain, options, floor=floor, odom=True) as path:
            sizes = RATES[-1:] if options.smoke else RATES
            curves[name] = [_at_rate(path, float(rate), options) for rate in sizes]
    return curves


def _at_rate(path: PushPath, rate: float, options: Options) -> Point:
    run = path.push(rate, max(5, options.samples(int(_DURATION * rate))))
    return Point.of(rate, run.percent(run.cpu), run.latency)


def scans(options: Options) -> Curves:
    """Vary the number of beams in the answers of robot/ScannerData."""
    points = []
    for beams in BEAMS[:1] if options.smoke else BEAMS:
        with (
            own_domain() as domain,
            running_chassis(domain, "--beams", str(beams)) as (_, port),
            calling(domain) as caller,
            running_agent(domain, port, options) as program,
        ):
            calls = call_repeatedly(program, caller, SCAN, options.samples(300), options)
        points.append(Point.of(beams, calls.cpu / 1000, calls.times))
    return {"agent": points}


@dataclass(frozen=True)
class Sweep:
    """A size that is varied.

    Attributes:
        size: label of the size.
        cpu: label of the CPU figure.
        measure: returns the curves.
    """

    size: str
    cpu: str
    measure: Callable[[Options], Curves]


SWEEPS = {
    "robots": Sweep("robots, each pushes PoseSpeed at 20 Hz", "CPU, % of a core", robots),
    "rates": Sweep("pushes of PoseSpeed, Hz", "CPU, % of a core", rates),
    "scans": Sweep("beams of robot/ScannerData, JSON", "agent's CPU per call, ms", scans),
}


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the tables."""
    parser = make_parser("scale", __doc__)
    add_repetitions(parser)
    parser.add_argument(
        "--only", nargs="+", choices=SWEEPS, default=list(SWEEPS), help="sizes to vary"
    )
    given = parser.parse_args(arguments)

    def measure(name: str) -> dict[str, list[tuple[float, ...]]]:
        repeated = []
        for repetition in range(repetitions(given)):
            print(f"{repetition + 1}: {name}", file=sys.stderr, flush=True)
            repeated.append(SWEEPS[name].measure(Options(given.smoke)))
        return {
            curve: [astuple(point) for point in points]
            for curve, points in _medians(repeated).items()
        }

    found = dict(zip(given.only, measure_each(given, measure, given.only), strict=True))
    return report(given, found, _tables)


def _medians(repeated: Sequence[Curves]) -> Curves:
    """Return the medians of repetitions, at the sizes that all repetitions reached."""
    return {
        name: [
            Point(
                *(statistics.median(values) for values in zip(*map(astuple, points), strict=True))
            )
            for points in zip(*(curves[name] for curves in repeated), strict=False)
        ]
        for name in repeated[0]
    }


def _tables(found: dict[str, dict[str, list[tuple[float, ...]]]]) -> str:
    return "\n\n".join(
        markdown(
            ("", SWEEPS[name].size, SWEEPS[name].cpu, "latency, median, ms", "latency, p99, ms"),
            (
                (curve, f"{size:.0f}", *(f"{value:.2f}" for value in values))
                for curve, points in curves.items()
                for size, *values in points
            ),
        )
        for name, curves in found.items()
    )
