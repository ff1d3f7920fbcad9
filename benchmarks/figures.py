"""Figures and their tables: of robustness with limits, of speed with targets."""

from __future__ import annotations

import contextlib
import gc
import statistics
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from scripts.markdown_table import table as markdown

MICROSECONDS = 1e6
"""Microseconds in a second."""
Measured = dict[str, tuple[float, str]]
"""Figures of one repetition, by name: the value, and a text with the measurements behind it."""


# Robustness


@dataclass(frozen=True)
class Figure:
    """One figure of robustness.

    Attributes:
        part: part of the benchmark.
        name: what was measured.
        value: the result, with its unit.
        limit: requirement on the value; empty if the figure is for information only.
        ok: False if the limit was exceeded.
        depends_on_machine: True if a busy or slow machine may exceed the limit. Only the benchmark
            judges such a figure, because it can be repeated; the tests do not.
    """

    part: str
    name: str
    value: str
    limit: str = ""
    ok: bool = True
    depends_on_machine: bool = False

    @property
    def verdict(self) -> str:
        if not self.limit:
            return ""
        return "ok" if self.ok else "EXCEEDED"


def figures_table(figures: Iterable[Figure]) -> str:
    """Return a Markdown table with a row for each figure."""
    return markdown(
        ("", "Figure", "Found", "Limit", ""),
        ((each.part, each.name, each.value, each.limit, each.verdict) for each in figures),
    )


def print_and_judge(figures: Sequence[Figure]) -> int:
    """Print the table of figures, and those that exceed their limits to stderr.

    Returns:
        The exit status: 1 if a limit was exceeded, otherwise 0.
    """
    print(figures_table(figures))
    exceeded = [figure for figure in figures if not figure.ok]
    for figure in exceeded:
        print(f"exceeded: {figure.part}: {figure.name}: {figure.value}", file=sys.stderr)
    return 1 if exceeded else 0


# Speed


@dataclass(frozen=True)
class Spread:
    """Median and 99th percentile of some times, in microseconds."""

    median: float
    p99: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Spread:
        """Return the spread of times in seconds."""
        ordered = sorted(seconds)
        p99 = ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))]
        return cls(statistics.median(ordered) * MICROSECONDS, p99 * MICROSECONDS)

    def __str__(self) -> str:
        return f"{self.median:.0f} (p99 {self.p99:.0f})"


@contextlib.contextmanager
def no_garbage_collection() -> Iterator[None]:
    """Disable Python's garbage collector in this process while the block runs."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@dataclass(frozen=True)
class Target:
    """Target values of a figure of speed.

    Attributes:
        required: value that must be reached; None if there is none.
        aim: value that should be reached.
        description: description of the figure.
        higher_is_better: False if the figure should be at most these values.
    """

    required: float | None
    aim: float
    description: str
    higher_is_better: bool = False

    def verdict(self, value: float) -> str:
        """Return in words how a value compares with both target values."""

        def reaches(limit: float) -> bool:
            return value >= limit if self.higher_is_better else value <= limit

        if reaches(self.aim):
            return "aim met"
        if self.required is None:
            return f"aim missed by {abs(value / self.aim - 1):.0%}"
        if reaches(self.required):
            return "met"
        return f"missed by {abs(value / self.required - 1):.0%}"


@dataclass
class Results:
    """Figures of speed of all repetitions.

    Attributes:
        values: values of each figure, one per repetition.
        details: the values of agent and floor behind each of them, as text.
    """

    values: dict[str, list[float]] = field(default_factory=dict)
    details: dict[str, list[str]] = field(default_factory=dict)

    def add(self, measured: Measured) -> None:
        """Add figures of one repetition."""
        for name, (value, detail) in measured.items():
            self.values.setdefault(name, []).append(value)
            self.details.setdefault(name, []).append(detail)

    def medians(self, names: Iterable[str]) -> dict[str, float]:
        """Return the medians of those of some figures that were measured."""
        return {name: float(f"{self._median(name):.4g}") for name in names if name in self.values}

    def table(self, targets: Mapping[str, Target]) -> str:
        """Return a Markdown table with a row for each figure that was measured."""
        return markdown(
            ("Figure", "Measured", "Repetitions", "Must", "Aim", "", "What", "Agent / floor"),
            (
                (
                    f"`{name}`",
                    f"{self._median(name):.3g}",
                    f"{min(self.values[name]):.3g} to {max(self.values[name]):.3g}",
                    "" if target.required is None else f"{target.required:.3g}",
                    f"{target.aim:.3g}",
                    target.verdict(self._median(name)),
                    target.description,
                    self._detail(name),
                )
                for name, target in targets.items()
                if name in self.values
            ),
        )

    def _median(self, name: str) -> float:
        return statistics.median(self.values[name])

    def _detail(self, name: str) -> str:
        """Return the detail of the repetition whose value is closest to the median."""
        values = self.values[name]
        nearest = min(range(len(values)), key=lambda i: abs(values[i] - self._median(name)))
        return self.details[name][nearest]
