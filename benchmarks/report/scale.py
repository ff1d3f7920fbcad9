"""Measure how cost grows with the number of robots, the rate of pushes and the size of a scan.

scripts/bench --scale                 print the tables, medians of three repetitions
scripts/bench --scale --docs          also write tables and plots to docs/ (needs matplotlib)
scripts/bench --scale --only rates    only one of them
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Sequence
from dataclasses import astuple

from benchmarks.measurements.calls import SCAN, call_repeatedly, calling
from benchmarks.measurements.fleet import WAYS, Fleet, served
from benchmarks.measurements.pushes import PushPath, push_path
from benchmarks.options import Options, make_parser, parse, repetitions
from benchmarks.options import scale as scale_of
from benchmarks.programs.start import agent, echo_chassis
from benchmarks.report.curves import Curves, Point, Sweep
from benchmarks.report.machine import describe_machine
from benchmarks.report.pages import DOCS, write_part
from benchmarks.report.table import markdown
from woosh_robot_agent.testing import own_domain

ROBOTS = (1, 2, 5, 10, 15, 20, 30, 40, 60)
RATES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)
BEAMS = (360, 720, 1080, 2000, 5000, 10_000, 20_000)
_DURATION = 5.0


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
            echo_chassis(domain, options.transport, "--beams", str(beams)) as (_, port),
            calling(domain) as caller,
            agent(domain, port, options) as program,
        ):
            calls = call_repeatedly(program, caller, SCAN, options.samples(300), options)
        points.append(Point.of(beams, calls.cpu / 1000, calls.times))
    return {"agent": points}


SWEEPS = {
    "robots": Sweep(
        "robots", "CPU of all agents, % of a core", "each pushes PoseSpeed at 20 Hz", robots
    ),
    "rates": Sweep("pushes, Hz", "CPU, % of a core", "PoseSpeed of one robot", rates),
    "scans": Sweep("beams", "agent's CPU per call, ms", "robot/ScannerData, JSON", scans),
}


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the tables."""
    parser = make_parser("scale", __doc__)
    parser.add_argument(
        "--only", nargs="+", choices=SWEEPS, default=list(SWEEPS), help="sizes to vary"
    )
    given = parse(parser, arguments)
    if given.docs:
        # imported before the measurement, so that a missing matplotlib is noticed at once
        from benchmarks.report import plots
    tables, values = [], {}
    for name in given.only:
        found = []
        for repetition in range(repetitions(given)):
            print(f"{repetition + 1}: {name}", file=sys.stderr, flush=True)
            found.append(SWEEPS[name].measure(Options(given.executor, scale_of(given))))
        curves = _medians(found)
        tables.append(_table(SWEEPS[name], curves))
        values[name] = {of: [astuple(each) for each in points] for of, points in curves.items()}
        if given.docs:
            machine = describe_machine()
            plots.draw(DOCS / f"speed_{name}.svg", SWEEPS[name], curves, machine)
            image = f"![{SWEEPS[name].size}](speed_{name}.svg)"
            write_part(name, f"{image}\n\n{machine}.\n\n{tables[-1]}")
    print(json.dumps(values) if given.json else "\n\n".join(tables))
    return 0


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


def _table(sweep: Sweep, curves: Curves) -> str:
    return markdown(
        ("", sweep.size, sweep.cpu, "latency, median, ms", "latency, p99, ms"),
        (
            (name, f"{p.size:.0f}", f"{p.cpu:.2f}", f"{p.median:.2f}", f"{p.p99:.2f}")
            for name, points in curves.items()
            for p in points
        ),
    )
