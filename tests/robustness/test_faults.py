"""Each fault alone, in the middle of a user's traffic: the agent keeps its promises."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.robustness.rig import KINDS, Rig
from tests.robustness.scenarios import ALONE, PAIRS, Outcome, plan, run
from woosh_robot_agent.simulator.faults import FAULTS

BACK_WITHIN = 10.0
"""s; what a machine with much else to do may need on top of the bench's limit."""


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    """One agent for all of them: what one fault leaves behind, the next one meets."""
    running = Rig(KINDS[0])
    yield running
    running.close()


def test_no_fault_is_forgotten() -> None:
    assert [name for (name,) in ALONE] == list(FAULTS)
    assert len(PAIRS) == len(FAULTS) * (len(FAULTS) - 1) // 2


def test_a_seed_stands_for_one_scenario() -> None:
    assert [plan(seed) for seed in range(300)] == [plan(seed) for seed in range(300)]


@pytest.mark.parametrize("seed", range(len(ALONE)), ids=list(FAULTS))
def test_alone(rig: Rig, seed: int) -> None:
    check(run(rig, plan(seed), BACK_WITHIN))


def check(outcome: Outcome) -> None:
    assert not outcome.violations, f"seed {outcome.seed}: {outcome.violations}"
    assert outcome.calls == outcome.answered_once > 0
    assert outcome.goals == outcome.goals_ended
