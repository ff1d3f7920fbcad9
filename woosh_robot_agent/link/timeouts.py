"""Waiting for asynchronous work with a timeout."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")

_GRACE = 1.0
"""Maximum wait for cancelled work to end, in seconds. Only a library that blocks uses it up."""


async def run_with_timeout(timeout: float, work: Coroutine[Any, Any, T] | asyncio.Future[T]) -> T:
    """Return the result of `work`; cancel it on timeout, and when the caller is cancelled.

    Use it instead of `asyncio.wait_for`. In Python 3.10 and 3.11, that swallows a cancellation that
    coincides with a result, and it waits for cancelled work without a limit.

    Raises:
        TimeoutError: `work` took longer than `timeout` seconds.
    """
    task = asyncio.ensure_future(work)
    try:
        await asyncio.wait({task}, timeout=timeout)
        if task.done():
            return task.result()
        raise TimeoutError(f"not within {timeout:g} s")
    finally:
        if not task.done():
            await cancel_and_wait(task)
        elif not task.cancelled():
            task.exception()  # marks it as retrieved


async def cancel_and_wait(*tasks: asyncio.Future[Any]) -> None:
    """Cancel tasks and wait for their end, at most one second."""
    for task in tasks:
        task.cancel()
        task.add_done_callback(_retrieve_exception)
    if tasks:
        await asyncio.wait(tasks, timeout=_GRACE)


async def wait_then_cancel(task: asyncio.Future[Any]) -> None:
    """Wait at most one second for a task that is about to end by itself, then cancel it."""
    try:
        await asyncio.wait({task}, timeout=_GRACE)
    finally:
        await cancel_and_wait(task)


def _retrieve_exception(task: asyncio.Future[Any]) -> None:
    if not task.cancelled():
        task.exception()
