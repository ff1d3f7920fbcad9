"""The other end of the link, over WebSocket or TCP, for programs that stand in for a chassis."""

from __future__ import annotations

import asyncio
import contextlib
import re
import struct
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from websockets.frames import Opcode

from woosh_robot_agent.link.frames import Codec
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.link.transport import (
    CHUNK,
    TcpTransport,
    Transport,
    TransportClosedError,
    WebSocketTransport,
    serve,
    varint,
)


class ServerTransport(Transport, Protocol):
    """A server's end of one connection."""

    def header(self, size: int, *, text: bool = False) -> bytes:
        """Return the bytes that precede a frame from the server.

        Args:
            size: size of the frame in bytes, up to 2^63 - 1.
            text: True for a text frame, where the transport has them; otherwise a binary one.
        """

    async def send_raw(self, data: bytes) -> None:
        """Write bytes without a frame around them; waits while the buffer is full.

        Call it only between two frames. Bytes that are not a frame may make the connection
        unusable.

        Raises:
            TransportClosedError: the connection has ended.
        """

    def pause(self) -> None:
        """Stop reading from the socket, pings included, until `resume`."""

    def resume(self) -> None:
        """Resume reading from the socket."""


Handler = Callable[[ServerTransport], Awaitable[None]]
"""Serves one connection; the connection ends when it returns."""


_CLOSE_TIMEOUT = 1.0
"""Maximum wait for the listening sockets to close, and for a closing handshake, in seconds."""


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


Write = Callable[[ServerTransport], Awaitable[None]]
"""Writes to a connection in place of an ordinary frame."""

Encoded = str | bytes | Write
"""An encoded frame, or a function that writes something other than an ordinary frame."""

_MAX_BYTES = 64 * 1024 * 1024
"""Number of queued bytes above which a client is dropped instead of getting another frame."""


class ConnectedClient:
    """A client that is connected to a server.

    Args:
        transport: The open connection.
        max_outbox: Maximum number of queued frames. A client that exceeds it is dropped.

    Attributes:
        topics: Subscribed topics, each with the codec of the subscription.
    """

    def __init__(self, transport: ServerTransport, max_outbox: int) -> None:
        self.transport = transport
        self.topics: dict[str, Codec] = {}
        self._max_outbox = max_outbox
        self._outbox: deque[Encoded] = deque()
        self._outbox_bytes = 0
        """Size of the queued frames, in bytes."""
        self._filled = asyncio.Event()
        self._open = True

    @property
    def backlog(self) -> int:
        """Number of frames that wait to be written."""
        return len(self._outbox)

    @property
    def unsent(self) -> int:
        """Queued frames plus bytes in the transport's buffer; 0 once everything has been sent."""
        return len(self._outbox) + self.transport.backlog()

    def send(self, frame: Encoded) -> None:
        """Queue a frame without waiting."""
        if self._has_room():
            self._outbox.append(frame)
            self._outbox_bytes += _size(frame)
            self._filled.set()

    def drop(self) -> None:
        """Abort the connection, as a broken cable would."""
        self.forget()
        self.transport.abort()

    def forget(self) -> None:
        """Discard all queued frames, and send nothing further."""
        self._open = False
        self._outbox.clear()
        self._outbox_bytes = 0

    async def write(self, running: asyncio.Event) -> None:
        """Send queued frames until the connection ends, while `running` is set."""
        with contextlib.suppress(TransportClosedError):
            while self._open:
                await self._filled.wait()
                await running.wait()
                if not self._outbox:
                    self._filled.clear()
                    continue
                frame = self._outbox.popleft()
                self._outbox_bytes -= _size(frame)
                if callable(frame):
                    await frame(self.transport)
                else:
                    await self.transport.send(frame)
        self._open = False

    def _waiting_frames(self) -> int:
        """Return the number of frames that count towards `max_outbox`."""
        return len(self._outbox)

    def _has_room(self) -> bool:
        """Return True if another frame may be queued. Otherwise drop the client."""
        is_full = self._waiting_frames() >= self._max_outbox or self._outbox_bytes > _MAX_BYTES
        if self._open and is_full:
            self.drop()
        return self._open


def _size(frame: Encoded) -> int:
    """Return the approximate size of a frame in bytes; 0 for a function that writes."""
    return 0 if callable(frame) else len(frame)


class TcpServerTransport(TcpTransport):
    """The server's end of a TCP connection."""

    def header(self, size: int, *, text: bool = False) -> bytes:
        return varint(size)

    async def send_raw(self, data: bytes) -> None:
        await self._write(data)

    def pause(self) -> None:
        self._read_side.pause_reading()

    def resume(self) -> None:
        self._read_side.resume_reading()

    @property
    def _read_side(self) -> Any:
        return self._writer.transport  # one object for both directions


async def serve_tcp(handler: Handler, host: str, port: int, *, max_size: int) -> Listener:
    """Listen for TCP clients.

    Args:
        handler: serves one connection.
        host: the address to listen on.
        port: the port to listen on; 0 takes a free one.
        max_size: largest frame that is read, in bytes.
    """

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await handler(TcpServerTransport(reader, writer, max_size))

    return Listener(await asyncio.start_server(handle, host, port))


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
