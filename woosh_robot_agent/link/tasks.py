"""Tasks that start at once."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


def start_task(work: Coroutine[Any, Any, T], name: str | None = None) -> asyncio.Task[T]:
    """Start a coroutine in the running event loop.

    It runs as far as its first wait before this returns, which saves a turn of the event loop.
    Before Python 3.12 it starts with the loop's next turn.

    Args:
        work: the coroutine.
        name: name of the task, for debugging.
    """
    loop = asyncio.get_running_loop()
    if sys.version_info >= (3, 12):
        return asyncio.Task(work, loop=loop, name=name, eager_start=True)
    return loop.create_task(work, name=name)
