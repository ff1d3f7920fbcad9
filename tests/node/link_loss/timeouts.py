"""Timeouts of the agent for single tests, in place of the fixture `timeouts`."""

from __future__ import annotations

import pytest

short_timeouts = pytest.mark.parametrize(
    "timeouts", [{"goal_link_timeout": 0.8, "poll_timeout": 300}], ids=["short"]
)
"""Timeouts with which a goal is given up soon."""
medium_timeouts = pytest.mark.parametrize(
    "timeouts", [{"goal_link_timeout": 3.0, "poll_timeout": 1000}], ids=["medium"]
)
"""Timeouts with which a goal is given up, but not before the test makes the chassis hang."""
