"""The listening sockets of a server."""

from __future__ import annotations

import contextlib
from typing import Any

from woosh_robot_agent.link.timeouts import run_with_timeout

_CLOSE_TIMEOUT = 1.0
"""Maximum wait for the listening sockets to close, in seconds."""


class Listener:
    """The listening sockets of a server.

    Args:
        server: an asyncio or WebSocket server that is already listening.

    Attributes:
        port: actual port of the first socket, even if port 0 was requested.
        addresses: family and address of each socket.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self.addresses: list[tuple[int, Any]] = [
            (each.family, each.getsockname()) for each in server.sockets
        ]
        self.port: int = self.addresses[0][1][1]

    async def close(self) -> None:
        """Stop listening; open connections end with their handlers."""
        self._server.close()
        with contextlib.suppress(TimeoutError):
            await run_with_timeout(_CLOSE_TIMEOUT, self._server.wait_closed())
