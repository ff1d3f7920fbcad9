"""The simulator survives malformed input on its ports; `scripts/bench --fuzz` sends much more."""

from __future__ import annotations

import math

import pytest

from tests.robustness.fuzz import fuzz
from tests.robustness.fuzz_targets import ACCEPTED, Requests
from woosh_robot_agent.simulator.world.geometry import Pose

SEED = 1


@pytest.mark.parametrize(("key", "count"), [("requests", 1000), ("raw", 500)])
def test_simulator_serves_the_next_client_after_any_input(key: str, count: int) -> None:
    result = fuzz(key, count, SEED)
    assert not result.crashes, result.crashes[0]
    assert result.inputs == count
    if key == "requests":
        assert result.kinds[ACCEPTED] > count / 10
        assert result.kinds["refused with a text"] > count / 20


def test_check_notices_a_state_that_is_not_finite() -> None:
    """No request may cause such a state, so the test sets it directly."""
    target = Requests()
    try:
        target.simulator.chassis.base.pose = Pose(math.nan)
        with pytest.raises(AssertionError):
            target.loop.run_until_complete(target.check())
    finally:
        target.close()
