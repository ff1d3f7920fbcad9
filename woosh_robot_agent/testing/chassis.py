"""Run a simulated chassis in a test, and wait for conditions. Needs no ROS."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread

T = TypeVar("T")

TIMEOUT = 60.0
"""Default timeout of all waits, in seconds; long enough for a busy machine."""
_POLL_PERIOD = 0.005
"""Time between two calls of a condition, in seconds."""


def wait_until(condition: Callable[[], T], what: str = "", timeout: float = TIMEOUT) -> T:
    """Wait until a condition is true, by calling it every few milliseconds.

    Args:
        condition: function to call until it returns a true value.
        what: description of the condition, for the error message.
        timeout: maximum time to wait, in seconds.

    Returns:
        The value that the condition returned.

    Raises:
        AssertionError: the condition did not become true within `timeout`.
    """
    deadline = time.monotonic() + timeout
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f"timed out waiting for {what or condition}")
        time.sleep(_POLL_PERIOD)
    return value


@contextlib.contextmanager
def running_chassis(**options: Any) -> Iterator[SimulatorThread]:
    """Run a simulated chassis on free ports of this machine.

    Args:
        options: options of `SimulatorConfig`. The defaults here are `speed=10.0`, `seed=1`, and
            `profile="instant"`, whose answers have no delay.
    """
    defaults = {"port": 0, "tcp_port": 0, "speed": 10.0, "seed": 1, "profile": "instant"}
    config = SimulatorConfig(**{**defaults, **options})
    with SimulatorThread(config) as chassis:
        yield chassis
