"""Waiting with a bound."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")

_GRACE = 1.0
"""Longest wait in s for cancelled work to end; it does at once unless a library holds it up."""


async def within(timeout: float, work: Coroutine[Any, Any, T] | asyncio.Future[T]) -> T:
    """What `work` gives; it is cancelled when it takes too long, or when its caller is.

    `asyncio.wait_for` of Python 3.10 and 3.11 swallows a cancellation that meets a result, and
    waits without a bound for cancelled work.

    Raises:
        TimeoutError: `work` took longer than `timeout` s.
    """
    task = asyncio.ensure_future(work)
    try:
        await asyncio.wait({task}, timeout=timeout)
        if task.done():
            return task.result()
        raise TimeoutError(f"not within {timeout:g} s")
    finally:
        if not task.done():
            await drop(task)
        elif not task.cancelled():
            task.exception()  # retrieved, whether anybody gets it or not


async def drop(*tasks: asyncio.Future[Any]) -> None:
    """Cancel tasks, and wait a moment for their end."""
    for task in tasks:
        task.cancel()
        task.add_done_callback(_retrieve)
    if tasks:
        await asyncio.wait(tasks, timeout=_GRACE)


async def settle(task: asyncio.Future[Any]) -> None:
    """Wait a moment for a task that is about to end by itself, then `drop` it."""
    try:
        await asyncio.wait({task}, timeout=_GRACE)
    finally:
        await drop(task)


def _retrieve(task: asyncio.Future[Any]) -> None:
    if not task.cancelled():
        task.exception()
