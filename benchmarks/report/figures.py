"""Figures of a benchmark of robustness, with their limits and verdicts."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from benchmarks.report.table import markdown


@dataclass(frozen=True)
class Figure:
    """One figure.

    Attributes:
        part: Part of the benchmark.
        name: What was measured.
        value: The result, with its unit.
        limit: Requirement on the value; empty if the figure is for information only.
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
