"""Waiting for conditions in tests."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

TIMEOUT = 60.0
"""Default timeout of all waits, in seconds. Even a busy machine does not need that long."""
_POLL_PERIOD = 0.005
"""Time between two calls of a condition, in seconds."""


def wait_until(condition: Callable[[], T], what: str = "", timeout: float = TIMEOUT) -> T:
    """Wait until a condition is true, by calling it every few milliseconds.

    Args:
        condition: Function to call until it returns a true value.
        what: Description of the condition, for the error message.
        timeout: Maximum time to wait, in seconds.

    Returns:
        The value that the condition returned.

    Raises:
        AssertionError: The condition did not become true within `timeout`.
    """
    deadline = time.monotonic() + timeout
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f"timed out waiting for {what or condition}")
        time.sleep(_POLL_PERIOD)
    return value
