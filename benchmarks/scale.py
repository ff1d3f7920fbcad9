"""How the cost grows with the number of robots, with the rate of pushes, with the size of a scan.

scripts/bench --scale                 tables, medians of three repetitions
scripts/bench --scale --docs          puts them and their plots into docs/ (needs matplotlib)
scripts/bench --scale --only rates    one of them
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass

from benchmarks import machine, pages
from benchmarks.calls import SCAN, calling, trips
from benchmarks.fleet import WAYS, Fleet, percent, served
from benchmarks.options import Options, Spread, parsed, parser, repetitions
from benchmarks.options import scale as scale_of
from benchmarks.programs import agent, echo_chassis
from benchmarks.pushes import Line, line
from tests.harness import own_domain

ROBOTS = (1, 2, 5, 10, 15, 20, 30, 40, 60)
RATES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)
BEAMS = (360, 720, 1080, 2000, 5000, 10_000, 20_000)
_SECONDS = 5.0


@dataclass(frozen=True)
class Point:
    """What something cost at one size.

    Attributes:
        size: number of robots, rate, number of beams.
        cpu: of the agents: percent of a core; for scans ms per call.
        median, p99: latency in ms.
    """

    size: float
    cpu: float
    median: float
    p99: float

    @classmethod
    def of(cls, size: float, cpu: float, times: Spread) -> Point:
        return cls(size, cpu, times.median / 1000, times.p99 / 1000)


Curves = dict[str, list[Point]]
"""By what they are of."""


@dataclass(frozen=True)
class Plot:
    """One thing to vary.

    Attributes:
        size: what is varied.
        cpu: what is said of the CPU.
        what: what stays as it is.
        measure: makes the curves.
    """

    size: str
    cpu: str
    what: str
    measure: Callable[[Options], Curves]


def robots(options: Options) -> Curves:
    """Robots at 20 Hz, in processes of their own and several in one, as long as they are served."""
    curves: Curves = {}
    for words, shared in WAYS.items():
        points = curves.setdefault(words, [])
        with Fleet(options, shared=shared) as fleet:
            for count in ROBOTS[:1] if options.smoke else ROBOTS:
                fleet.grow(count - fleet.robots)
                row = fleet.push()
                points.append(Point.of(count, percent(row, row.cpu), row.latency))
                if not served(row) and not options.smoke:
                    break
    return curves


def rates(options: Options) -> Curves:
    """Pushes of one robot, odom included, as the agent is by default; and the bare publisher's."""
    curves: Curves = {}
    for name, floor in (("agent", False), ("bare publish", True)):
        with own_domain() as domain, line(domain, options, floor=floor, odom=True) as made:
            sizes = RATES[-1:] if options.smoke else RATES
            curves[name] = [_at_rate(made, float(rate), options) for rate in sizes]
    return curves


def _at_rate(made: Line, rate: float, options: Options) -> Point:
    row = made.push(rate, max(5, options.count(int(_SECONDS * rate))))
    return Point.of(rate, percent(row, row.cpu), row.latency)


def scans(options: Options) -> Curves:
    """Calls of robot/ScannerData, one after the other."""
    points = []
    for beams in BEAMS[:1] if options.smoke else BEAMS:
        with (
            own_domain() as domain,
            echo_chassis(domain, options.transport, "--beams", str(beams)) as (_, port),
            calling(domain) as caller,
            agent(domain, port, options) as program,
        ):
            called = trips(program, caller, SCAN, options.count(300), options)
        points.append(Point.of(beams, called.cpu / 1000, called.times))
    return {"agent": points}


PLOTS = {
    "robots": Plot(
        "robots", "CPU of all agents, % of a core", "each pushes PoseSpeed at 20 Hz", robots
    ),
    "rates": Plot("pushes, Hz", "CPU, % of a core", "PoseSpeed of one robot", rates),
    "scans": Plot("beams", "agent's CPU per call, ms", "robot/ScannerData, JSON", scans),
}


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the tables."""
    options = parser("scale", __doc__)
    options.add_argument("--only", nargs="*", choices=PLOTS, default=list(PLOTS))
    given = parsed(options, arguments)
    if given.docs:
        from benchmarks import plots  # now: without matplotlib it must not fail at the end
    texts, values = [], {}
    for name in given.only:
        found = []
        for repetition in range(repetitions(given)):
            print(f"{repetition + 1}: {name}", file=sys.stderr, flush=True)
            found.append(PLOTS[name].measure(Options(given.executor, scale_of(given))))
        curves = medians(found)
        texts.append(table(PLOTS[name], curves))
        values[name] = {of: [astuple(each) for each in points] for of, points in curves.items()}
        if given.docs:
            plots.draw(pages.DOCS / f"speed_{name}.svg", PLOTS[name], curves, machine.described())
            image = f"![{PLOTS[name].size}](speed_{name}.svg)"
            pages.write(name, f"{image}\n\n{machine.described()}.\n\n{texts[-1]}")
    print(json.dumps(values) if given.json else "\n\n".join(texts))
    return 0


def medians(found: Sequence[Curves]) -> Curves:
    """Of several repetitions, point by point; of sizes that all of them reached."""
    return {
        name: [
            Point(
                *(statistics.median(values) for values in zip(*map(astuple, points), strict=True))
            )
            for points in zip(*(each[name] for each in found), strict=False)
        ]
        for name in found[0]
    }


def table(plot: Plot, curves: Curves) -> str:
    """The points in Markdown."""
    rows = [
        f"| | {plot.size} | {plot.cpu} | latency, median, ms | latency, p99, ms |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, points in curves.items():
        rows += [
            f"| {name} | {p.size:.0f} | {p.cpu:.2f} | {p.median:.2f} | {p.p99:.2f} |"
            for p in points
        ]
    return "\n".join(rows)
