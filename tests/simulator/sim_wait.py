"""Waiting for conditions that no frame announces."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from tests.simulator.sim_wire import TIMEOUT


def wait_until(condition: Callable[[], Any], what: str = "") -> Any:
    """Wait until a condition is true and return its value."""
    deadline = time.monotonic() + TIMEOUT
    while not (value := condition()):
        assert time.monotonic() < deadline, f"timed out waiting for {what or condition}"
        time.sleep(0.005)
    return value
