"""Mixed traffic with every fault: nothing in the agent grows.

`scripts/bench --soak` goes on for an hour and also checks the memory.
"""

from __future__ import annotations

import pytest

from benchmarks.figures import figures_table
from benchmarks.robustness.soak import Length, run

SHORT = Length(
    seconds=6.0,
    fault_every=0.6,
    reference_after=3.0,
    sample_every=2.0,
    samples_at_rest=1,
    rest_timeout=300.0,
)
"""A length sufficient to inject a third of the faults; `test_faults` has each of them."""


@pytest.mark.timeout(900)
def test_nothing_is_left_behind_by_traffic_and_faults() -> None:
    _, figures = run(SHORT)
    broken = [each for each in figures if not each.ok and not each.depends_on_machine]
    assert not broken, "\n" + figures_table(figures)
