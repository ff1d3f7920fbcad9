"""The agent keeps its promises under pairs of faults; `scripts/bench --faults` has many more."""

from __future__ import annotations

import math

import pytest

from tests.robustness.faults import run_block
from tests.robustness.rig import KINDS
from tests.robustness.scenarios import ALONE, BLOCK, COMBINATIONS

SCENARIOS = 6
"""Number of scenarios with each kind of agent."""


def pairs(kind: int) -> list[int]:
    """Return seeds of pairs of faults for one kind of agent, spread evenly over all pairs."""
    seeds = [
        seed for seed in range(len(ALONE), len(COMBINATIONS)) if seed // BLOCK % len(KINDS) == kind
    ]
    return seeds[kind :: len(seeds) // SCENARIOS][:SCENARIOS]


@pytest.mark.parametrize("kind", range(len(KINDS)), ids=lambda kind: "-".join(KINDS[kind].values()))
def test_promises_hold_under_two_faults(kind: int) -> None:
    outcomes = run_block(pairs(kind), back_within=math.inf)
    broken = {each.seed: each.violations for each in outcomes if each.violations}
    assert not broken
    assert len(outcomes) == SCENARIOS
    assert sum(each.goals for each in outcomes) > 0
    assert all(each.calls == each.answered_once for each in outcomes)
