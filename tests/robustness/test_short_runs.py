"""Short runs of the robustness benchmarks: faults, floods, and traffic amid all faults.

`scripts/bench` with `--faults`, `--flood` and `--soak` goes on for longer: with each fault and each
kind of agent, and with a check of the memory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing

import pytest

from benchmarks.figures import Figure, figures_table
from benchmarks.robustness import flood, soak
from benchmarks.robustness.rig import KINDS, Rig
from benchmarks.robustness.scenarios import ALONE, PAIRS, plan, run
from woosh_robot_agent.testing import wait_until


def seeds_of(kind: int) -> list[int]:
    """Return seeds for one kind of agent: of its share of the single faults, and of two pairs."""
    alone = range((kind + 1) % len(KINDS), len(ALONE), len(KINDS))
    first, second = (len(ALONE) + len(PAIRS) * (kind + n * len(KINDS)) // 6 for n in (0, 1))
    return [*alone, first, second]


def check(figures: Sequence[Figure]) -> None:
    broken = [each for each in figures if not each.ok and not each.depends_on_machine]
    assert not broken, "\n" + figures_table(figures)


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


@pytest.mark.timeout(900)
def test_floods_are_answered_and_leave_nothing_behind() -> None:
    size = flood.Size(seconds=0.5, calls=1000, frame=2, slow=1.0, callers=1)
    check(flood.run(size, measure_memory=False))


@pytest.mark.timeout(900)
def test_nothing_is_left_behind_by_traffic_and_faults() -> None:
    # sufficient to inject a third of the faults; above is each of them
    short = soak.Length(
        seconds=6.0,
        fault_every=0.6,
        reference_after=3.0,
        sample_every=2.0,
        samples_at_rest=1,
        rest_timeout=300.0,
    )
    _, figures = soak.run(short)
    check(figures)
