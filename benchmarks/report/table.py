"""Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def markdown(header: Sequence[str], rows: Iterable[Sequence[object]], align: str = "") -> str:
    """Return a Markdown table.

    Args:
        header: Titles of the columns.
        rows: Cells of each row.
        align: One letter per column, `l` or `r`; empty aligns all columns left.
    """
    rules = ["---:" if letter == "r" else "---" for letter in align or "l" * len(header)]
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in (header, rules, *rows))
