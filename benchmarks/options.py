"""Command line of the benchmarks of speed, and the report of their figures."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

from woosh_robot_agent.testing import own_domain

_TURNS = 5
"""Number of times that agent and floor are measured alternately in one repetition.

The speed of a machine drifts, and measuring alternately cancels that out.
"""
LINKS = {
    "WebSocket, JSON": ("websocket", "json"),
    "WebSocket, protobuf": ("websocket", "protobuf"),
    "TCP, protobuf": ("tcp", "protobuf"),
}
"""Transport and encoding of each kind of link, by its title in tables."""
_SMOKE_SCALE = 0.01
_SMOKE_THREADS = 3
"""Number of measurements at a time if their figures mean nothing. Most of the time they wait."""
Found = TypeVar("Found")
Part = TypeVar("Part")


@dataclass(frozen=True)
class Options:
    """Options of one measurement.

    Attributes:
        smoke: True if the benchmark is only checked to work, with meaningless figures.
        transport: transport of the link.
        encoding: encoding of the link.
    """

    smoke: bool = False
    transport: str = "websocket"
    encoding: str = "json"

    @property
    def scale(self) -> float:
        """Factor on the usual durations and numbers of samples."""
        return _SMOKE_SCALE if self.smoke else 1.0

    @property
    def turns(self) -> int:
        """Number of times that agent and floor are measured alternately."""
        return 1 if self.smoke else _TURNS

    def samples(self, usual: int) -> int:
        """Return the number of samples to take instead of the usual one."""
        return max(5, int(usual * self.scale))

    @property
    def agent_parameters(self) -> dict[str, str]:
        """Parameters of the agent, as set by these options."""
        return {"transport": self.transport, "encoding": self.encoding}


def make_parser(name: str, description: str | None) -> argparse.ArgumentParser:
    """Return a parser with the options that all benchmarks of speed have."""
    parser = argparse.ArgumentParser(
        prog=f"scripts/bench --{name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object, not tables")
    parser.add_argument(
        "--smoke", action="store_true", help="run for seconds, only to see that it works"
    )
    return parser


def add_repetitions(parser: argparse.ArgumentParser) -> None:
    """Add the options of benchmarks that repeat a measurement."""
    parser.add_argument(
        "--repeat", type=_positive, default=3, help="repetitions to take the median of (default 3)"
    )


def _positive(text: str) -> int:
    if (number := int(text)) < 1:
        raise ValueError(text)
    return number


def repetitions(given: argparse.Namespace) -> int:
    """Return the number of repetitions."""
    return 1 if given.smoke else int(given.repeat)


def measure_each(
    given: argparse.Namespace, measure: Callable[[Part], Found], parts: Iterable[Part]
) -> list[Found]:
    """Measure parts of a benchmark one after the other, but in a smoke run some at a time."""
    if not given.smoke:
        return list(map(measure, parts))
    # the outer domain keeps the variables set, which each inner one resets at its end
    with own_domain(), ThreadPoolExecutor(_SMOKE_THREADS) as pool:
        return list(pool.map(measure, parts))


def report(
    given: argparse.Namespace,
    found: Found,
    table: Callable[[Found], str],
    excess: Callable[[Found], Sequence[str]] = lambda _: (),
) -> int:
    """Print what was measured, and what exceeds its limit to stderr.

    Args:
        given: options of the command line.
        found: the figures, as JSON has them.
        table: returns the figures as Markdown.
        excess: returns the limits that are exceeded, as text.

    Returns:
        The exit status: 1 if a limit was exceeded, otherwise 0.
    """
    print(json.dumps(found) if given.json else table(found))
    problems = () if given.smoke else excess(found)
    for problem in problems:
        print(f"exceeded: {problem}", file=sys.stderr)
    return int(bool(problems))
