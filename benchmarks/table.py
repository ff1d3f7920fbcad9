"""What a measurement found, as a Markdown table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """One figure of a measurement.

    Attributes:
        part: which part of the measurement it belongs to.
        name: what was measured.
        value: what was found, with its unit.
        limit: what it must be; empty where the figure is for information only.
        kept: whether it is within the limit.
    """

    part: str
    name: str
    value: str
    limit: str = ""
    kept: bool = True

    @property
    def verdict(self) -> str:
        if not self.limit:
            return ""
        return "ok" if self.kept else "EXCEEDED"


def markdown(figures: Sequence[Figure]) -> str:
    """All figures, one row each."""
    rows = ["| | Figure | Found | Limit | |", "| --- | --- | --- | --- | --- |"]
    for figure in figures:
        cells = (figure.part, figure.name, figure.value, figure.limit, figure.verdict)
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows)
