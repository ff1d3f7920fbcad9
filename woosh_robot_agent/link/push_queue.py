"""The queue between the reader, which never waits, and the consumers of pushes."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Mapping

from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.protos import full_name

COUNTED_PUSHES = tuple(full_name(cls) for cls in (StatusCode, TaskProc, Feedbacks))
"""Types of which every push must be delivered. Of other types, only the newest values matter."""
LATEST_DEPTH = 50
"""Maximum number of queued pushes of a type of which only the newest values matter. Enough
for 17 ms at 3000 Hz, in which another program may use the core."""

Deliver = Callable[[], Awaitable[None] | None]
"""Delivers a push; if it returns an awaitable, the pushes behind it wait for that."""


class PushQueue:
    """A queue of pushes in the order of their arrival, with a limit for each type.

    Args:
        depths: maximum number of queued pushes, by type; `LATEST_DEPTH` for all other types.
        dropped: counter of drops, by type.
    """

    def __init__(self, depths: Mapping[str, float], dropped: Counter[str]) -> None:
        self._depths = depths
        self._dropped = dropped
        self._queue: deque[tuple[str, Deliver]] = deque()
        """The type of each push, and the function that delivers it."""
        self._waiting: dict[str, int] = {}
        """Number of queued pushes, by type."""
        self._filled = asyncio.Event()

    def __len__(self) -> int:
        return len(self._queue)

    def put(self, name: str, deliver: Deliver) -> bool:
        """Add a push, as the function that delivers it.

        Returns:
            False if the oldest push of this type was dropped to make room.
        """
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

    async def get(self) -> Deliver:
        """Wait for the next push and return the function that delivers it."""
        while True:
            if self._queue:
                name, deliver = self._queue.popleft()
                self._waiting[name] -= 1
                return deliver
            self._filled.clear()
            await self._filled.wait()

    def take_all(self) -> list[tuple[str, Deliver]]:
        """Remove all pushes; return their types and the functions that deliver them."""
        pushes = list(self._queue)
        self._queue.clear()
        self._waiting.clear()
        return pushes

    def _discard_oldest(self, name: str) -> None:
        for index, (queued, _) in enumerate(self._queue):
            if queued == name:
                del self._queue[index]
                return
