"""The agent keeps its promises under each fault and under pairs, amid traffic.

`scripts/bench --faults` has many more pairs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from benchmarks.robustness.faults import run_block
from benchmarks.robustness.rig import KINDS, Rig
from benchmarks.robustness.scenarios import ALONE, BLOCK, COMBINATIONS, plan, run
from woosh_robot_agent.simulator.faults import FAULTS

SCENARIOS = 2
"""Number of scenarios of two faults with each kind of agent."""


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    """One agent for all faults, so that leftovers of one affect the next."""
    running = Rig(KINDS[0])
    yield running
    running.close()


def test_seed_determines_the_scenario() -> None:
    assert [plan(seed) for seed in range(300)] == [plan(seed) for seed in range(300)]


@pytest.mark.parametrize("seed", range(len(ALONE)), ids=list(FAULTS))
def test_promises_hold_under_one_fault(rig: Rig, seed: int) -> None:
    outcome = run(rig, plan(seed), back_within=math.inf)
    assert not outcome.violations, f"seed {outcome.seed}: {outcome.violations}"
    assert outcome.calls == outcome.answered_once > 0
    assert outcome.goals == outcome.goals_ended


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
