"""Work on large messages aside, in a thread of its own, so that it does not hold up velocities."""

from __future__ import annotations

import asyncio
import contextvars
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")

LARGE = 64 * 1024
"""Length of a frame from which it is handled aside, in characters or bytes.

A shorter one takes some milliseconds at most.
"""
_SWITCH_INTERVAL = 0.0005
"""Time for which other threads wait for the GIL while this one works, in seconds. The link thread
waits for it after each system call; with Python's 5 ms, a few of them would hold it for 20 ms."""
_THREAD = ThreadPoolExecutor(1, thread_name_prefix="large messages")
"""One thread, so that large messages keep their order, and at most one competes for the GIL."""


async def aside(function: Callable[..., T], *args: Any) -> T:
    """Return the result of a function that runs in the thread for large messages.

    The function must consist of small steps of Python: a long call into C that keeps the GIL would
    hold up all threads.
    """
    context = contextvars.copy_context()  # of the logger
    return await asyncio.get_running_loop().run_in_executor(
        _THREAD, context.run, _run, function, *args
    )


def _run(function: Callable[..., T], *args: Any) -> T:
    interval = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    try:
        return function(*args)
    finally:
        sys.setswitchinterval(interval)
