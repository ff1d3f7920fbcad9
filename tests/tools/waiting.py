"""A decorator for asynchronous tests, and a function that waits for a condition."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Coroutine
from typing import Any

TIMEOUT = 60.0


def aio(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Run an asynchronous test; fail it on an unhandled exception."""

    @functools.wraps(test)
    def run(*args: Any, **kwargs: Any) -> None:
        unhandled: list[Any] = []

        async def main() -> None:
            loop = asyncio.get_running_loop()
            loop.set_exception_handler(lambda _, context: unhandled.append(context))
            await asyncio.wait_for(test(*args, **kwargs), 3 * TIMEOUT)

        asyncio.run(main())
        assert not unhandled, unhandled

    return run


async def eventually(condition: Callable[[], Any], what: str = "") -> Any:
    """Poll a condition until it is true; return its value."""
    deadline = asyncio.get_running_loop().time() + TIMEOUT
    while not (value := condition()):
        if asyncio.get_running_loop().time() > deadline:
            raise AssertionError(f"timed out waiting for {what or condition}")
        await asyncio.sleep(0.005)
    return value
