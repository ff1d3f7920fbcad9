"""What the agent costs over the floor: ratios of medians, floors interleaved with the agent.

scripts/bench --speed                 all figures, three repetitions
scripts/bench --speed --json          one JSON object instead of the table
scripts/bench --speed --only push_cpu convert_pose
scripts/bench --speed --smoke         a short run without judgement, to see that it works
scripts/bench --speed --docs          puts the table into docs/speed.md
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from benchmarks import calls, conversions, fleet, machine, pages, presence, pushes
from benchmarks.options import Measured, Options, parsed, parser, repetitions, scale
from tests.harness import own_domain


@dataclass(frozen=True)
class Wanted:
    """One figure.

    Attributes:
        must: what it must be; None where it is only told.
        aim: what it should be.
        what: what it is.
        more: whether more is better.
    """

    must: float | None
    aim: float
    what: str
    more: bool = False

    def verdict(self, value: float) -> str:
        def reaches(limit: float) -> bool:
            return value >= limit if self.more else value <= limit

        if reaches(self.aim):
            return "aim met"
        if self.must is None:
            return f"aim missed by {abs(value / self.aim - 1):.0%}"
        return "met" if reaches(self.must) else f"missed by {abs(value / self.must - 1):.0%}"


FIGURES = {
    "service_rtt": Wanted(2.0, 1.5, "median of a service call / (bare service + bare WebSocket)"),
    "service_rtt_p99": Wanted(3.0, 2.0, "the same at p99"),
    "service_cpu": Wanted(2.0, 1.3, "agent's CPU per call / (bare server + bare client)"),
    "concurrent": Wanted(0.90, 0.95, "10 calls at a time, 50 ms each: throughput / ideal", True),
    "push_latency": Wanted(1.3, 1.1, "push to subscriber at 100 Hz / bare publish"),
    "push_cpu": Wanted(1.5, 1.1, "agent's CPU per push at 100 Hz / bare publish"),
    "push_max": Wanted(0.5, 0.8, "highest rate without loss / bare publish's", True),
    "convert_pose": Wanted(1 / 8, 1 / 15, "PoseSpeed, JSON to ROS / ParseDict and reflection"),
    "convert_scan": Wanted(1 / 15, 1 / 25, "scan of 1080 beams, the same"),
    "convert_info": Wanted(1 / 6, 1 / 12, "full RobotInfo, the same"),
    "idle_rss": Wanted(1.35, 1.15, "resident memory / a node with the same entities"),
    "idle_cpu": Wanted(1.0, 0.3, "percent of a core, connected and quiet"),
    "startup": Wanted(
        2.0, 1.3, "start to connected and discovered / a node with the same entities"
    ),
    "fleet": Wanted(None, 60, "robots served at 20 Hz each, the better of the two ways", True),
}

Measure = Callable[[int, Options], Measured]
#: What measures which figures: each runs agent and floors one after the other, in one domain.
MEASURES: tuple[tuple[Measure, tuple[str, ...]], ...] = (
    (calls.services, ("service_rtt", "service_rtt_p99", "service_cpu", "concurrent")),
    (pushes.pushes, ("push_latency", "push_cpu", "push_max")),
    (conversions.conversions, ("convert_pose", "convert_scan", "convert_info")),
    (presence.presence, ("idle_rss", "idle_cpu", "startup")),
    (fleet.fleet, ("fleet",)),
)
BEFORE = pages.DOCS / "speed_before.json"
"""What `--json` gave before the agent was made fast."""


@dataclass
class Figures:
    """What was measured, repetition by repetition, by name; and the bare values below it."""

    ratios: dict[str, list[float]] = field(default_factory=dict)
    details: dict[str, list[str]] = field(default_factory=dict)

    def add(self, measured: Measured) -> None:
        for name, (ratio, detail) in measured.items():
            self.ratios.setdefault(name, []).append(ratio)
            self.details.setdefault(name, []).append(detail)

    def median(self, name: str) -> float:
        return statistics.median(self.ratios[name])

    def range(self, name: str) -> str:
        """The smallest and the largest of the repetitions."""
        return f"{min(self.ratios[name]):.3g} to {max(self.ratios[name]):.3g}"

    def detail(self, name: str) -> str:
        """The bare values of the repetition that is the median."""
        ratios = self.ratios[name]
        nearest = min(range(len(ratios)), key=lambda i: abs(ratios[i] - self.median(name)))
        return self.details[name][nearest]


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table. The exit status does not judge: machines differ."""
    options = parser("speed", __doc__)
    options.add_argument("--only", nargs="+", choices=FIGURES, default=list(FIGURES))
    options.add_argument("--transport", default="websocket", choices=("websocket", "tcp"))
    options.add_argument("--encoding", default="json", choices=("json", "protobuf"))
    given = parsed(options, arguments)
    plain = (given.transport, given.encoding, set(given.only)) == (
        "websocket",
        "json",
        set(FIGURES),
    )
    if given.docs and not (plain and given.repeat >= 3):
        options.error("--docs wants all figures, three repetitions, and the default link")
    figures = measured(
        Options(given.executor, scale(given), given.transport, given.encoding),
        repetitions(given),
        given.only,
    )
    names = [name for name in FIGURES if name in figures.ratios]
    found = table(figures, names)
    if given.json:
        print(json.dumps({name: float(f"{figures.median(name):.4g}") for name in names}))
    else:
        print(found)
    if given.docs:
        pages.write("figures", f"{machine.described()}; executor `{given.executor}`.\n\n{found}")
    return 0


def measured(options: Options, repeat: int, only: Sequence[str]) -> Figures:
    """All figures that are asked for, and those that come with them."""
    figures = Figures()
    for repetition in range(repeat):
        for measure, names in MEASURES:
            if set(names) & set(only):
                print(f"{repetition + 1}: {', '.join(names)}", file=sys.stderr, flush=True)
                with own_domain() as domain:
                    figures.add(measure(domain, options))
    return figures


def table(figures: Figures, names: Sequence[str]) -> str:
    """The figures in Markdown."""
    before = json.loads(BEFORE.read_text()) if BEFORE.exists() else {}
    rows = [
        "| Figure | Before | Measured | Repetitions | Must | Aim | | What | Agent / floor |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name in names:
        wanted, value = FIGURES[name], figures.median(name)
        cells = (
            f"`{name}`",
            f"{before[name]:.3g}" if name in before else "",
            f"{value:.3g}",
            figures.range(name),
            "" if wanted.must is None else f"{wanted.must:.3g}",
            f"{wanted.aim:.3g}",
            wanted.verdict(value),
            wanted.what,
            figures.detail(name),
        )
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
