"""Waiting in tests: for conditions, never for a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

TIMEOUT = 60.0
"""Keeps a test from hanging, in seconds; far more than anything takes on an overloaded machine."""


def wait_until(condition: Callable[[], T], what: str = "", timeout: float = TIMEOUT) -> T:
    """Wait for a condition that no event announces.

    Args:
        condition: asked every few ms until it gives something true.
        what: what is waited for, for the error.
        timeout: s after which to give up.

    Returns:
        What the condition gave.

    Raises:
        AssertionError: it did not come true in time.
    """
    deadline = time.monotonic() + timeout
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f"timed out waiting for {what or condition}")
        time.sleep(0.005)
    return value
