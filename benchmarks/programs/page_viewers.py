"""Viewers of the page in the browser, which watch until SIGINT.

    python -m benchmarks.programs.page_viewers URL NUMBER

It prints the number of viewers once each of them has received a laser scan.
"""

from __future__ import annotations

import asyncio
import sys
from contextlib import AsyncExitStack
from typing import Any
from urllib.parse import urlsplit

from woosh_robot_agent.link.transport import ClientSocket, Connect


def connect(url: str) -> Any:
    """Return a connection to the page at `url`, as a browser makes it."""
    place = urlsplit(url).netloc
    is_new = "websockets.asyncio" in ClientSocket.__module__
    header = {"additional_headers" if is_new else "extra_headers": {"Origin": f"http://{place}"}}
    return Connect(f"ws://{place}/live", factory=ClientSocket, compression=None, **header)


async def first_scan(socket: Any) -> None:
    """Receive messages until the first laser scan. Those before it come only at the beginning."""
    while not isinstance(await socket.recv(), bytes):
        pass


async def main(url: str, number: int) -> None:
    async with AsyncExitStack() as stack:
        sockets = [await stack.enter_async_context(connect(url)) for _ in range(number)]
        await asyncio.gather(*map(first_scan, sockets))
        print(number, flush=True)
        await asyncio.gather(*map(_watch, sockets))


async def _watch(socket: Any) -> None:
    async for _ in socket:
        pass


if __name__ == "__main__":
    try:
        asyncio.run(main(sys.argv[1], int(sys.argv[2])))
    except KeyboardInterrupt:
        sys.exit(0)
