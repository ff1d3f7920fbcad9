"""How a measurement of speed is to be made, and what it gives."""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from woosh_robot_agent.parameters import EXECUTORS

Measured = dict[str, tuple[float, str]]
"""Figures of one repetition, by name: the value, and the bare ones that it comes from."""
TURNS = 5
"""How often agent and floor take turns in a repetition: no machine is equally fast all the time."""
_US = 1e6
_SMOKE = 0.01


@dataclass(frozen=True)
class Options:
    """How to measure.

    Attributes:
        executor: the agent's. The floors have the plain one, whatever this is.
        scale: share of the usual number of samples.
        transport, encoding: of the link.
    """

    executor: str = EXECUTORS[0]
    scale: float = 1.0
    transport: str = "websocket"
    encoding: str = "json"

    @property
    def smoke(self) -> bool:
        """Whether it only has to work."""
        return self.scale < 1.0

    def count(self, usual: int) -> int:
        """A number of samples."""
        return max(5, int(usual * self.scale))

    @property
    def agent(self) -> dict[str, str]:
        """The agent's parameters."""
        return {
            "executor": self.executor,
            "transport": self.transport,
            "encoding": self.encoding,
        }


def parser(name: str, description: str | None, repeat: int = 3) -> argparse.ArgumentParser:
    """What all measurements of speed take."""
    made = argparse.ArgumentParser(
        prog=f"scripts/bench --{name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("--repeat", type=int, default=repeat, help="repetitions, for the median")
    made.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    made.add_argument("--smoke", action="store_true", help="very short, to see that it works")
    made.add_argument("--docs", action="store_true", help="put what is found into docs/speed.md")
    made.add_argument("--executor", default=EXECUTORS[0], choices=EXECUTORS, help="the agent's")
    return made


def parsed(made: argparse.ArgumentParser, arguments: Sequence[str]) -> argparse.Namespace:
    """What was asked for; ends the program where that makes no sense."""
    given = made.parse_args(arguments)
    if given.repeat < 1:
        made.error("--repeat must be 1 or more")
    if given.docs and given.smoke:
        made.error("--docs wants figures that mean something, not those of --smoke")
    return given


def repetitions(given: argparse.Namespace) -> int:
    return 1 if given.smoke else int(given.repeat)


def scale(given: argparse.Namespace) -> float:
    return _SMOKE if given.smoke else 1.0


@dataclass(frozen=True)
class Spread:
    """Median and p99 of times, in µs."""

    median: float
    p99: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Spread:
        ordered = sorted(seconds)
        p99 = ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))]
        return cls(statistics.median(ordered) * _US, p99 * _US)

    def __str__(self) -> str:
        return f"{self.median:.0f} (p99 {self.p99:.0f})"
