"""How asynchronous tests run, and a function that waits for a condition."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable, Coroutine
from typing import Any

TIMEOUT = 60.0
"""Time after which a test stops waiting, in seconds; much longer than any of them needs."""


def run_test(test: Coroutine[Any, Any, None], leaves_nothing: bool) -> None:
    """Run a test; fail it on an unhandled exception, and if it leaves a task unless it may."""
    troubles: list[Any] = []

    def note(context: dict[str, Any]) -> None:
        # the server of websockets 10.4 raises when it ends during a handshake
        if "'WebSocketServerProtocol'" not in str(context.get("exception")):
            troubles.append(context)

    async def main() -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, context: note(context))
        await asyncio.wait_for(test, 3 * TIMEOUT)
        if leaves_nothing:
            await eventually(lambda: not others(), f"tasks to end: {others()}", 10.0)
            gc.collect()
            await asyncio.sleep(0)

    asyncio.run(main())
    assert not troubles, troubles


def others() -> list[asyncio.Task[Any]]:
    """Return all tasks except the current one."""
    return [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]


async def eventually(condition: Callable[[], Any], what: str = "", timeout: float = TIMEOUT) -> Any:
    """Poll until `condition` is true, and return its value."""
    deadline = time.monotonic() + timeout
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f"timed out waiting for {what or condition}")
        await asyncio.sleep(0.005)
    return value
