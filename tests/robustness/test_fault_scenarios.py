"""Faults in pairs: some of the scenarios that `scripts/bench --faults` runs by the thousand."""

from __future__ import annotations

import pytest

from tests.robustness.faults import run_block
from tests.robustness.rig import KINDS
from tests.robustness.scenarios import ALONE, BLOCK, COMBINATIONS

BACK_WITHIN = 10.0
"""s; what a machine with much else to do may need on top of the bench's limit."""
EACH = 9
"""Scenarios with each kind of agent."""


def pairs(kind: int) -> list[int]:
    """Seeds of pairs that an agent of this kind meets, from all over the table."""
    seeds = [
        seed for seed in range(len(ALONE), len(COMBINATIONS)) if seed // BLOCK % len(KINDS) == kind
    ]
    return seeds[kind :: len(seeds) // EACH][:EACH]


@pytest.mark.parametrize("kind", range(len(KINDS)), ids=lambda kind: "-".join(KINDS[kind].values()))
def test_pairs(kind: int) -> None:
    outcomes = run_block(pairs(kind), BACK_WITHIN)
    broken = {each.seed: each.violations for each in outcomes if each.violations}
    assert not broken
    assert len(outcomes) == EACH
    assert sum(each.goals for each in outcomes) > 0
    assert all(each.calls == each.answered_once for each in outcomes)
