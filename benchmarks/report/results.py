"""Results of benchmarks of speed, compared with target values."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from benchmarks.measurements.samples import Measured
from benchmarks.report.table import markdown


@dataclass(frozen=True)
class Target:
    """Target values of a figure.

    Attributes:
        required: Value that must be reached; None if there is none.
        aim: Value that should be reached.
        description: Description of the figure.
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
    """Figures of all repetitions.

    Attributes:
        values: Values of each figure, one per repetition.
        details: The values of agent and floor behind each of them, as text.
    """

    values: dict[str, list[float]] = field(default_factory=dict)
    details: dict[str, list[str]] = field(default_factory=dict)

    def add(self, measured: Measured) -> None:
        """Add figures of one repetition."""
        for name, (value, detail) in measured.items():
            self.values.setdefault(name, []).append(value)
            self.details.setdefault(name, []).append(detail)

    def median(self, name: str) -> float:
        """Return the median of a figure."""
        return statistics.median(self.values[name])

    def range(self, name: str) -> str:
        """Return the smallest and the largest value of a figure, as text."""
        return f"{min(self.values[name]):.3g} to {max(self.values[name]):.3g}"

    def detail(self, name: str) -> str:
        """Return the detail of the repetition whose value is closest to the median."""
        values = self.values[name]
        nearest = min(range(len(values)), key=lambda i: abs(values[i] - self.median(name)))
        return self.details[name][nearest]

    def medians(self, names: Iterable[str]) -> dict[str, float]:
        """Return the medians of those of some figures that were measured."""
        return {name: float(f"{self.median(name):.4g}") for name in names if name in self.values}


def results_table(results: Results, targets: Mapping[str, Target]) -> str:
    """Return a Markdown table with a row for each figure that was measured."""
    return markdown(
        ("Figure", "Measured", "Repetitions", "Must", "Aim", "", "What", "Agent / floor"),
        (
            (
                f"`{name}`",
                f"{results.median(name):.3g}",
                results.range(name),
                "" if target.required is None else f"{target.required:.3g}",
                f"{target.aim:.3g}",
                target.verdict(results.median(name)),
                target.description,
                results.detail(name),
            )
            for name, target in targets.items()
            if name in results.values
        ),
    )
