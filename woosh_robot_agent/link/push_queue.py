"""The queue between the reader, which must never wait, and those who take the pushes."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Callable, Mapping

LATEST_DEPTH = 50
"""Pushes of one state that may wait; beyond it the newest ones stay. So many are what comes at 3000
Hz while another program has the core."""


class PushQueue:
    """Pushes in the order in which they came, bounded per type.

    Args:
        depths: how many may wait, by type, where that is not `LATEST_DEPTH`.
        dropped: where drops are counted, by type.
    """

    def __init__(self, depths: Mapping[str, float], dropped: Counter[str]) -> None:
        self._depths = depths
        self._dropped = dropped
        self._queue: deque[tuple[str, Callable[[], None]]] = deque()
        self._waiting: dict[str, int] = {}
        self._filled = asyncio.Event()

    def put(self, name: str, deliver: Callable[[], None]) -> bool:
        """Add a push, as what delivers it; False if an older one of its type had to go."""
        waiting = self._waiting.get(name, 0)
        fits = waiting < self._depths.get(name, LATEST_DEPTH)
        if fits:
            self._waiting[name] = waiting + 1
        else:
            self._dropped[name] += 1
            self._discard_oldest(name)
        self._queue.append((name, deliver))
        self._filled.set()
        return fits

    async def get(self) -> Callable[[], None]:
        """Wait for the next push; the caller delivers it."""
        while True:
            if self._queue:
                name, deliver = self._queue.popleft()
                self._waiting[name] -= 1
                return deliver
            self._filled.clear()
            await self._filled.wait()

    def _discard_oldest(self, name: str) -> None:
        for index, (queued, _) in enumerate(self._queue):
            if queued == name:
                del self._queue[index]
                return
