"""What the agent costs over the floor: ratios of medians, floors interleaved with the agent.

scripts/bench --speed                 all figures, three repetitions
scripts/bench --speed --json          one JSON object instead of the table
scripts/bench --speed --only push_cpu convert_pose
scripts/bench --speed --smoke         a short run without judgement, to see that it works
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from harness import own_domain

from bench import conversions, latencies, presence

FIGURES: dict[str, tuple[float, float, str]] = {
    "service_rtt": (2.0, 1.5, "median of a service call / bare service + bare WebSocket"),
    "service_rtt_p99": (3.0, 2.0, "the same at p99"),
    "service_cpu": (2.0, 1.3, "agent's CPU per call / bare server + bare client"),
    "concurrent": (0.90, 0.95, "10 calls at a time, 50 ms each: throughput / ideal"),
    "push_latency": (1.3, 1.1, "push to subscriber at 100 Hz / bare publish"),
    "push_cpu": (1.5, 1.1, "agent's CPU per push at 100 Hz / bare publish"),
    "push_max": (0.5, 0.8, "highest rate without loss / bare publish's"),
    "convert_pose": (1 / 8, 1 / 15, "PoseSpeed, JSON to ROS / ParseDict and reflection"),
    "convert_scan": (1 / 15, 1 / 25, "scan of 1080 beams, the same"),
    "convert_info": (1 / 6, 1 / 12, "full RobotInfo, the same"),
    "idle_rss": (1.35, 1.15, "resident memory / a node with the same entities"),
    "idle_cpu": (1.0, 0.3, "percent of a core, connected and quiet"),
    "startup": (2.0, 1.3, "start to connected and discovered / a node with the same entities"),
}
"""By name: what must be, what is aimed at, and what it is. For `concurrent` and `push_max` more is
better, for all others less."""
_MORE_IS_BETTER = ("concurrent", "push_max")


@dataclass
class Options:
    """How to measure.

    Attributes:
        executor: the agent's, and that of the floors.
        scale: share of the usual number of samples.
        transport, encoding: of the link.
    """

    executor: str = "single"
    scale: float = 1.0
    transport: str = "websocket"
    encoding: str = "json"

    def count(self, usual: int) -> int:
        """A number of samples."""
        return max(5, int(usual * self.scale))

    @property
    def link(self) -> dict[str, str]:
        """The agent's parameters for the link."""
        return {"transport": self.transport, "encoding": self.encoding}


@dataclass
class Figures:
    """What was measured, repetition by repetition, by name; and the bare values below it."""

    ratios: dict[str, list[float]] = field(default_factory=dict)
    details: dict[str, list[str]] = field(default_factory=dict)

    def add(self, measured: dict[str, tuple[float, str]]) -> None:
        for name, (ratio, detail) in measured.items():
            self.ratios.setdefault(name, []).append(ratio)
            self.details.setdefault(name, []).append(detail)

    def median(self, name: str) -> float:
        return statistics.median(self.ratios[name])

    def detail(self, name: str) -> str:
        """The bare values of the repetition that is the median."""
        ratios = self.ratios[name]
        nearest = min(range(len(ratios)), key=lambda i: abs(ratios[i] - self.median(name)))
        return self.details[name][nearest]


Measure = Callable[[int, Options], dict[str, tuple[float, str]]]
#: What measures which figures: each runs agent and floors one after the other, in one domain.
MEASURES: tuple[tuple[Measure, tuple[str, ...]], ...] = (
    (latencies.services, ("service_rtt", "service_rtt_p99", "service_cpu")),
    (latencies.concurrency, ("concurrent",)),
    (latencies.pushes, ("push_latency", "push_cpu")),
    (latencies.push_rates, ("push_max",)),
    (conversions.conversions, ("convert_pose", "convert_scan", "convert_info")),
    (presence.idle, ("idle_rss", "idle_cpu")),
    (presence.startup, ("startup",)),
)


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the table. The exit status does not judge: machines differ."""
    parser = argparse.ArgumentParser(prog="scripts/bench --speed", description=__doc__)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--smoke", action="store_true")
    parser.add_argument("--only", nargs="*", choices=FIGURES, default=list(FIGURES))
    parser.add_argument("--executor", default="single")
    parser.add_argument("--transport", default="websocket", choices=("websocket", "tcp"))
    parser.add_argument("--encoding", default="json", choices=("json", "protobuf"))
    given = parser.parse_args(arguments)
    options = Options(given.executor, 0.01 if given.smoke else 1.0, given.transport, given.encoding)
    figures = Figures()
    for repetition in range(1 if given.smoke else given.repeat):
        for measure, names in MEASURES:
            if not set(names) & set(given.only):
                continue
            print(f"{repetition + 1}: {', '.join(names)}", file=sys.stderr, flush=True)
            with own_domain() as domain:
                figures.add(measure(domain, options))
    names = [name for name in FIGURES if name in figures.ratios]
    if given.json:
        print(json.dumps({name: round(figures.median(name), 4) for name in names}))
    else:
        print(table(figures, names))
    return 0


def table(figures: Figures, names: Sequence[str]) -> str:
    """The figures in Markdown."""
    rows = [
        "| Figure | Measured | Must | Aim | | What | Medians |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name in names:
        must, aim, what = FIGURES[name]
        value = figures.median(name)
        sign = -1 if name in _MORE_IS_BETTER else 1
        verdict = "aim met" if sign * value <= sign * aim else "met"
        if sign * value > sign * must:
            verdict = f"missed by {abs(value / must - 1):.0%}"
        rows.append(
            f"| `{name}` | {value:.3f} | {must:.3f} | {aim:.3f} | {verdict} | {what} "
            f"| {figures.detail(name)} |"
        )
    return "\n".join(rows)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
