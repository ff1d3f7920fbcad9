"""Three minutes of mixed traffic and faults; `scripts/bench --soak` goes on for an hour."""

from __future__ import annotations

import pytest

from benchmarks.table import markdown
from tests.robustness.soak import Length, run

SHORT = Length(seconds=180.0, fault_every=8.0, reference_after=60.0, sample_every=5.0)


@pytest.mark.timeout(600)
def test_nothing_grows_with_time() -> None:
    _, figures = run(SHORT)
    assert all(figure.kept for figure in figures), "\n" + markdown(figures)
