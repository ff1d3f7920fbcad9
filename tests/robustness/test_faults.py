"""The agent keeps its promises under each fault and under pairs, amid traffic.

`scripts/bench --faults` has each fault with each kind of agent, and many more pairs.
"""

from __future__ import annotations

import math
from contextlib import closing

import pytest

from benchmarks.robustness.rig import KINDS, Rig
from benchmarks.robustness.scenarios import ALONE, PAIRS, plan, run
from woosh_robot_agent.testing import wait_until


def seeds_of(kind: int) -> list[int]:
    """Return seeds for one kind of agent: of its share of the single faults, and of two pairs."""
    alone = range((kind + 1) % len(KINDS), len(ALONE), len(KINDS))
    first, second = (len(ALONE) + len(PAIRS) * (kind + n * len(KINDS)) // 6 for n in (0, 1))
    return [*alone, first, second]


def test_seed_determines_the_scenario() -> None:
    assert [plan(seed) for seed in range(300)] == [plan(seed) for seed in range(300)]


@pytest.mark.timeout(900)
@pytest.mark.parametrize("kind", range(len(KINDS)), ids=lambda kind: "-".join(KINDS[kind].values()))
def test_promises_hold_under_one_fault_and_under_two(kind: int) -> None:
    with closing(Rig(KINDS[kind])) as rig:  # one agent, so that leftovers of a fault affect others
        slow = rig.simulator.inject("freeze")
        rig.traffic().speak()
        wait_until(lambda: "requests" in rig.in_flight(), "what `run` waits for to be shown")
        slow.clear()
        for seed in seeds_of(kind):
            outcome = run(rig, plan(seed), back_within=math.inf)
            assert not outcome.violations, f"{seed} {outcome.faults}: {outcome.violations}"
            assert outcome.calls == outcome.answered_once > 0
            assert outcome.goals == outcome.goals_ended
