"""Every call under load is answered once, and nothing is left behind.

`scripts/bench --flood` goes on for longer and also checks the memory.
"""

from __future__ import annotations

import pytest

from benchmarks.figures import figures_table
from benchmarks.robustness.flood import Size, run


@pytest.mark.timeout(900)
def test_floods_are_answered_and_leave_nothing_behind() -> None:
    size = Size(seconds=0.5, calls=1000, frame=2, slow=1.0, callers=1)
    figures = run(size, measure_memory=False)
    broken = [each for each in figures if not each.ok and not each.depends_on_machine]
    assert not broken, "\n" + figures_table(figures)
