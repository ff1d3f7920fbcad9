"""Markdown tables, for the generated documents and the benchmarks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table(header: Sequence[str], rows: Iterable[Iterable[object]], align: str = "") -> str:
    """Return a Markdown table.

    Args:
        header: titles of the columns.
        rows: cells of each row.
        align: one letter per column, `l` or `r`; empty aligns all columns left.
    """
    rules = ["---:" if letter == "r" else "---" for letter in align or "l" * len(header)]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in (header, rules, *rows))
