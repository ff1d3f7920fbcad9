"""A short run of the fuzzing of the simulator's ports; scripts/bench --fuzz has the long one."""

from __future__ import annotations

import math

import pytest

from tests.robustness.fuzz import fuzz
from tests.robustness.fuzz_targets import ACCEPTED, Requests
from woosh_robot_agent.simulator.world.geometry import Pose

SEED = 1


@pytest.mark.parametrize(("key", "count"), [("requests", 1000), ("raw", 500)])
def test_no_input_breaks_it_for_the_next_client(key: str, count: int) -> None:
    result = fuzz(key, count, SEED)
    assert not result.crashes, result.crashes[0]
    assert result.inputs == count
    if key == "requests":
        assert result.kinds[ACCEPTED] > count / 10
        assert result.kinds["refused with a text"] > count / 20


def test_a_state_that_is_not_finite_would_be_noticed() -> None:
    """The check itself, on a state that no request may bring about."""
    target = Requests()
    try:
        target._simulator.chassis.base.pose = Pose(math.nan)
        with pytest.raises(AssertionError):
            target.loop.run_until_complete(target.check())
    finally:
        target.close()
