"""The agent keeps its promises under each fault, amid traffic."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from tests.robustness.rig import KINDS, Rig
from tests.robustness.scenarios import ALONE, PAIRS, plan, run
from woosh_robot_agent.simulator.faults import FAULTS


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    """One agent for all faults, so that leftovers of one affect the next."""
    running = Rig(KINDS[0])
    yield running
    running.close()


def test_every_fault_and_every_pair_is_covered() -> None:
    assert [name for (name,) in ALONE] == list(FAULTS)
    assert len(PAIRS) == len(FAULTS) * (len(FAULTS) - 1) // 2


def test_seed_determines_the_scenario() -> None:
    assert [plan(seed) for seed in range(300)] == [plan(seed) for seed in range(300)]


@pytest.mark.parametrize("seed", range(len(ALONE)), ids=list(FAULTS))
def test_promises_hold_under_one_fault(rig: Rig, seed: int) -> None:
    outcome = run(rig, plan(seed), back_within=math.inf)
    assert not outcome.violations, f"seed {outcome.seed}: {outcome.violations}"
    assert outcome.calls == outcome.answered_once > 0
    assert outcome.goals == outcome.goals_ended
