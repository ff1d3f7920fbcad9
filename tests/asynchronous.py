"""How asynchronous tests run, and what they share: waits, and a server that reads nothing."""

from __future__ import annotations

import asyncio
import gc
import socket
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
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


@contextmanager
def listening(receive_buffer: int) -> Iterator[socket.socket]:
    """Listen on a port; what a connection cannot buffer, in bytes, stays in the sender's kernel."""
    with socket.socket() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        server.bind(("127.0.0.1", 0))
        server.listen()
        server.setblocking(False)
        yield server


async def read_to_end(connection: socket.socket, within: float = TIMEOUT) -> None:
    """Read what arrives, each part within a time in seconds, until the other end closes."""
    loop = asyncio.get_running_loop()
    while await asyncio.wait_for(loop.sock_recv(connection, 1 << 20), within):
        pass
