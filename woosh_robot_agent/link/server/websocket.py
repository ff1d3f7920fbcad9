"""Serving WebSocket clients."""

from __future__ import annotations

import asyncio
import re
import struct
from collections.abc import Awaitable, Callable
from typing import Any

from websockets.frames import Opcode

from woosh_robot_agent.link.server.base import Handler
from woosh_robot_agent.link.server.listener import Listener
from woosh_robot_agent.link.transport.base import CHUNK, TransportClosedError
from woosh_robot_agent.link.transport.websocket import WebSocketTransport
from woosh_robot_agent.link.transport.websockets_compat import serve

_CLOSE_TIMEOUT = 1.0
"""Timeout of the closing handshake, in seconds."""
_FINAL_FRAGMENT = 0x80
"""Bit of a frame's first byte that marks the last fragment of a message."""
_DRAIN_POLL = 0.002
"""Time between two checks of a full write buffer, in seconds."""


class WebSocketServerTransport(WebSocketTransport):
    """The server's end of a WebSocket."""

    def __init__(self, socket: Any) -> None:
        super().__init__(socket, raw_text=False)

    def header(self, size: int, *, text: bool = False) -> bytes:
        first = _FINAL_FRAGMENT | (Opcode.TEXT if text else Opcode.BINARY)
        if size < 126:
            return struct.pack("!BB", first, size)
        if size < 2**16:
            return struct.pack("!BBH", first, 126, size)
        return struct.pack("!BBQ", first, 127, size)

    async def send_raw(self, data: bytes) -> None:
        transport = self._socket.transport
        try:
            transport.write(data)
        except RuntimeError as error:  # the library has written the end of the stream
            raise TransportClosedError(f"the connection is being closed: {error}") from None
        # the library's own drain is private, and differs from release to release
        while transport.get_write_buffer_size() > CHUNK and not transport.is_closing():
            await asyncio.sleep(_DRAIN_POLL)
        if transport.is_closing():
            raise TransportClosedError("the connection ended without a close frame")

    def pause(self) -> None:
        self._socket.transport.pause_reading()

    def resume(self) -> None:
        self._socket.transport.resume_reading()


async def serve_websocket(
    handler: Handler,
    host: str,
    port: int,
    *,
    max_size: int,
    before: Callable[[], Awaitable[object]] | None = None,
    local_pages_only: bool = False,
) -> Listener:
    """Listen for WebSocket clients.

    Args:
        handler: serves one connection.
        host: the address to listen on.
        port: the port to listen on; 0 takes a free one.
        max_size: largest frame that is read, in bytes.
        before: awaited before a client's handshake is answered. After 10 s of waiting, the client
            is dropped.
        local_pages_only: refuse web pages as clients, except those of this machine.
    """

    async def handle(socket: Any) -> None:
        await handler(WebSocketServerTransport(socket))

    async def process_request(*_: Any) -> None:
        if before:
            await before()

    server = await serve(
        handle,
        host,
        port,
        max_size=max_size,
        compression=None,
        ping_interval=None,
        close_timeout=_CLOSE_TIMEOUT,
        process_request=process_request,
        origins=[None, _LocalOrigin()] if local_pages_only else None,
    )
    return Listener(server)


class _LocalOrigin:
    """Equals the origin of every web page of this machine.

    All releases of `websockets` compare a client's origin with the allowed ones by `==`.
    """

    _PATTERN = re.compile(r"https?://(localhost|127\.[0-9.]+|\[::1\])(:\d+)?")

    def __eq__(self, origin: object) -> bool:
        return isinstance(origin, str) and bool(self._PATTERN.fullmatch(origin))

    __hash__ = None  # type: ignore[assignment]
