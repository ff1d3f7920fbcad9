"""Order of frames on a WebSocket, whether they are taken at once or returned by `recv`."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Iterator
from typing import Any

from tests.link.link_peer import config, eventually, serve, soon, turns
from woosh_robot_agent.link.tasks import LARGE
from woosh_robot_agent.link.transport import ClientSocket, open_transport

CAN_TAKE = "websockets.asyncio" in ClientSocket.__module__
"""True if this release of websockets has what `Transport.take_at_once` needs."""


def frames(count: int) -> Iterator[str | list[str]]:
    """Yield small, fragmented and large frames in random order; each begins with its number."""
    shuffled = random.Random(7)
    for number in range(count):
        text = f"{number} "
        yield shuffled.choice([text, text, text, [text, "a", "b"], text + "x" * LARGE])


async def test_frames_keep_their_order_however_they_arrive() -> None:
    count = 300
    go_on = asyncio.Event()

    async def chassis(socket: Any) -> None:
        for number, frame in enumerate(frames(count)):
            await socket.send(frame if isinstance(frame, str) else in_turns(frame))
            if number % 50 == 49:  # the reader empties its queue, and takes frames at once again
                await soon(go_on.wait())
                go_on.clear()

    seen: list[int] = []
    taken: list[int] = []

    def note(data: str | bytes) -> int:
        seen.append(int(data.split()[0]))
        if len(seen) % 50 == 0:
            go_on.set()
        return seen[-1]

    async with serve(chassis, "127.0.0.1", 0, compression=None) as server:
        port = server.sockets[0].getsockname()[1]
        transport = await open_transport(config(port))
        transport.take_at_once(lambda data: taken.append(note(data)))
        reader = asyncio.ensure_future(read(transport, note))
        await eventually(lambda: len(seen) == count)
        reader.cancel()
        await transport.close()
    assert seen == list(range(count))
    assert bool(taken) == CAN_TAKE
    assert len(taken) < count


async def in_turns(parts: list[str]) -> AsyncIterator[str]:
    """Yield the fragments of a message; the reader waits for the next one meanwhile."""
    for part in parts:
        await turns()
        yield part


async def read(transport: Any, note: Any) -> None:
    while True:
        note(await transport.recv())
