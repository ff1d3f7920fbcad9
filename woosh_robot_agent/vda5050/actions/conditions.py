"""Waiting for conditions of the vehicle."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from woosh_robot_agent.link.timeouts import run_with_timeout


class Conditions:
    """Conditions that actions wait for. Call `check` after each event. Used in one event loop."""

    def __init__(self) -> None:
        self._waiting: dict[asyncio.Future[None], Callable[[], bool]] = {}

    async def wait(self, condition: Callable[[], bool], timeout: float | None = None) -> bool:
        """Wait until a condition holds; return False if it does not within `timeout` seconds."""
        if condition():
            return True
        holds = asyncio.get_running_loop().create_future()
        self._waiting[holds] = condition
        try:
            await (holds if timeout is None else run_with_timeout(timeout, holds))
        except TimeoutError:
            return False
        finally:
            del self._waiting[holds]
        return True

    def check(self) -> None:
        """Wake the waiting callers whose condition holds now."""
        for holds, condition in self._waiting.items():
            if not holds.done() and condition():
                holds.set_result(None)
