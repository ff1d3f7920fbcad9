"""An agent with Nav2's interfaces."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.harness import RunningAgent


@pytest.fixture
def agent(connect: Callable[..., RunningAgent]) -> RunningAgent:
    """An agent that is connected to the simulator, and has Nav2's interfaces."""
    return connect(nav2=True)
