"""The bridge under load; `scripts/bench --flood` does the same for longer."""

from __future__ import annotations

import pytest

from benchmarks.table import markdown
from tests.robustness.flood import Size, run


@pytest.mark.timeout(600)
def test_floods_leave_nothing_behind_and_hold_up_nobody() -> None:
    figures = run(Size(seconds=2.0, slow=2.0))
    assert all(figure.kept for figure in figures), "\n" + markdown(figures)
