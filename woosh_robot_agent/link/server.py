"""The server side of the link, over WebSocket or TCP, for programs that stand in for a chassis."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import struct
from collections import deque
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from typing import Any, Protocol

from aiohttp import WSCloseCode, WSMessage, WSMsgType, web

from woosh_robot_agent.link.frames import Codec
from woosh_robot_agent.link.tasks import abort_transport, close_or_abort, run_with_timeout
from woosh_robot_agent.link.transport import (
    CHUNK,
    FrameConnection,
    TcpTransport,
    TransportClosedError,
    peer_address,
    varint,
)


class ServerTransport(FrameConnection, Protocol):
    """The server's end of a connection, which can also write bytes that are no frame."""

    def header(self, size: int, *, text: bool = False) -> bytes:
        """Return the bytes that precede a frame from the server.

        Args:
            size: size of the frame in bytes, up to 2^63 - 1.
            text: True for a text frame, False for a binary one; TCP has only binary frames.
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
        server: an asyncio server that is already listening.
        http: the HTTP server that handles the connections; None for TCP.

    Attributes:
        port: actual port of the first socket, even if port 0 was requested.
        addresses: family and address of each socket.
    """

    def __init__(self, server: asyncio.Server, http: web.Server | None = None) -> None:
        self._server = server
        self._http = http
        self.addresses: list[tuple[int, Any]] = [
            (each.family, each.getsockname()) for each in server.sockets
        ]
        self.port: int = server.sockets[0].getsockname()[1]

    def drop(self) -> None:
        """Abort all HTTP connections, also idle ones; does nothing for TCP."""
        if self._http is None:
            return
        for connection in self._http.connections:
            if connection.transport is not None:
                abort_transport(connection.transport)

    async def close(self) -> None:
        """Stop listening, and end HTTP connections and WebSockets; TCP connections stay open.

        The handlers of WebSockets first get about a second to return. This returns after three
        seconds at most.
        """
        self._server.close()
        with contextlib.suppress(TimeoutError):
            if self._http:
                await run_with_timeout(2 * _CLOSE_TIMEOUT, self._http.shutdown(_CLOSE_TIMEOUT))
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
        max_outbox: maximum number of queued frames. A client that exceeds it is dropped.

    Attributes:
        topics: subscribed topics, each with the codec of the subscription.
    """

    def __init__(self, transport: ServerTransport, max_outbox: int) -> None:
        self.transport = transport
        self.topics: dict[str, Codec] = {}
        self._max_outbox = max_outbox
        self._outbox: deque[Encoded] = deque()
        self._outbox_bytes = 0
        """Size of the queued frames, in bytes."""
        self._not_empty = asyncio.Event()
        self._open = True

    @property
    def backlog(self) -> int:
        """Number of queued frames."""
        return len(self._outbox)

    @property
    def has_unsent(self) -> bool:
        """True if frames are queued, or bytes wait in the transport's buffer.

        A frame that a `Write` is sending does not count.
        """
        return bool(self._outbox or self.transport.backlog())

    def send(self, frame: Encoded) -> None:
        """Queue a frame without waiting."""
        if self._ensure_room():
            self._outbox.append(frame)
            self._outbox_bytes += _size(frame)
            self._not_empty.set()

    def drop(self) -> None:
        """Abort the connection, as a broken cable would."""
        self.forget()
        self.transport.abort()

    def forget(self) -> None:
        """Discard all queued frames, and send nothing further."""
        self._open = False
        self._outbox.clear()
        self._outbox_bytes = 0

    async def write(self, running: asyncio.Event | None = None) -> None:
        """Send queued frames until the connection ends, but nothing while `running` is not set.

        Cancel it when the connection has ended.
        """
        try:
            with contextlib.suppress(TransportClosedError):
                while self._open:
                    await self._not_empty.wait()
                    if running is not None:
                        await running.wait()
                    if not self._outbox:
                        self._not_empty.clear()
                        continue
                    frame = self._outbox.popleft()
                    self._outbox_bytes -= _size(frame)
                    if callable(frame):
                        await frame(self.transport)
                    else:
                        await self.transport.send(frame)
        except Exception:
            # without the drop, the client would wait for frames for ever
            _LOG.exception("cannot send a frame to %s", self.transport.peer)
            self.drop()
        self._open = False

    def _waiting_frames(self) -> int:
        """Return the number of frames that count towards `max_outbox`; a subclass may add some."""
        return len(self._outbox)

    def _ensure_room(self) -> bool:
        """Return True if a frame may be queued; drop the client if its queue is full."""
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

    def abort(self) -> None:
        abort_transport(self._writer.transport)  # what is unsent may still arrive: it is no command

    # asyncio's transport of the writer also reads

    def pause(self) -> None:
        self._writer.transport.pause_reading()  # type: ignore[attr-defined]

    def resume(self) -> None:
        self._writer.transport.resume_reading()  # type: ignore[attr-defined]


async def serve_tcp(handler: Handler, host: str, port: int, *, max_size: int) -> Listener:
    """Listen for TCP clients.

    Args:
        port: the port to listen on; 0 takes a free port.
        max_size: largest frame that is read, in bytes.

    Raises:
        OSError: the address or the port cannot be used.
    """

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await handler(TcpServerTransport(reader, writer, max_size))

    return Listener(await asyncio.start_server(handle, host, port))


_LOG = logging.getLogger(__name__)

_SILENT = logging.getLogger(f"{__name__}.http")
"""Logger of aiohttp. It is off, because aiohttp logs every request that it cannot parse, so that a
port scan would fill the log."""
_SILENT.disabled = True

_OPEN_TIMEOUT = 10.0
"""Maximum time from the connection to the first request, e.g. a handshake, in seconds."""
_KEEPALIVE_TIMEOUT = 60.0
"""Time for which a connection is kept for further HTTP requests, in seconds."""
_FINAL_FRAGMENT = 0x80
"""Bit of a frame's first byte that marks the last fragment of a message."""
_TOO_BIG_FRAME = struct.pack(
    "!BBH", _FINAL_FRAGMENT | WSMsgType.CLOSE, 2, WSCloseCode.MESSAGE_TOO_BIG
)
"""Frame that closes a WebSocket because of a message that is too large."""
_DRAIN_POLL = 0.002
"""Time between two checks of a full write buffer, in seconds."""


class HttpConnection(asyncio.Protocol):
    """A connection that aiohttp serves, with two limits that aiohttp lacks.

    1. A client that does not complete its first request in time, e.g. a handshake, is dropped.
    2. A WebSocket is closed as soon as more bytes have arrived than the largest message may have.
       aiohttp would receive all of the message first.

    Attributes:
        transport: the socket.
        lost: future that is done when the connection has ended.
    """

    def __init__(self, inner: asyncio.Protocol) -> None:
        loop = asyncio.get_running_loop()
        self.transport: asyncio.Transport
        self.lost: asyncio.Future[None] = loop.create_future()
        self._inner = inner
        self._unread = 0
        """Number of bytes that arrived since a message was last read."""
        self._max_unread: int | None = None
        """Maximum of `_unread`; None until the handshake of a WebSocket."""
        self._open_timer = loop.call_later(_OPEN_TIMEOUT, lambda: abort_transport(self.transport))

    def note_opened(self, max_message: int | None = None) -> None:
        """Note that the first request has arrived, or that the handshake is complete.

        Args:
            max_message: largest message that is read from the WebSocket, in bytes; None for an HTTP
                request.
        """
        self._open_timer.cancel()
        if max_message is not None:
            # CHUNK is room for headers of frames, and for the beginning of the next message
            self._max_unread = max_message + CHUNK

    def note_message_read(self) -> None:
        """Note that a message has been read from the WebSocket."""
        self._unread = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        self._inner.connection_made(transport)

    def data_received(self, data: bytes) -> None:
        if self._max_unread is not None:
            self._unread += len(data)
            if self._unread > self._max_unread:
                if not self.transport.is_closing():
                    self.transport.write(_TOO_BIG_FRAME)
                    self.transport.close()
                return
        self._inner.data_received(data)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def connection_lost(self, error: Exception | None) -> None:
        self._open_timer.cancel()
        if not self.lost.done():
            self.lost.set_result(None)
        self._inner.connection_lost(error)

    def pause_writing(self) -> None:
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self._inner.resume_writing()

    # For server transports over HTTP

    async def write(self, data: bytes) -> None:
        """Write bytes; waits while the buffer is full.

        Raises:
            TransportClosedError: the connection has ended.
        """
        try:
            self.transport.write(data)
        except RuntimeError as error:  # the end of the stream has been written
            raise TransportClosedError(f"the connection is being closed: {error}") from None
        # aiohttp's own drain is private
        while self.transport.get_write_buffer_size() > CHUNK and not self.transport.is_closing():
            await asyncio.sleep(_DRAIN_POLL)
        if self.transport.is_closing():
            raise TransportClosedError("the connection ended without a close frame")


class HttpServerTransport:
    """The part of a `ServerTransport` that is the same for a WebSocket and for an HTTP call."""

    def __init__(self, connection: HttpConnection) -> None:
        self._connection = connection
        self.peer = peer_address(connection.transport)

    def backlog(self) -> int:
        return self._connection.transport.get_write_buffer_size()

    async def send_raw(self, data: bytes) -> None:
        await self._connection.write(data)

    def abort(self) -> None:
        abort_transport(self._connection.transport)

    def pause(self) -> None:
        self._connection.transport.pause_reading()

    def resume(self) -> None:
        self._connection.transport.resume_reading()


class WebSocketServerTransport(HttpServerTransport):
    """A `ServerTransport` over WebSocket.

    Args:
        socket: the WebSocket, after the handshake.
        connection: the connection under it; limits the unread bytes.
    """

    def __init__(self, socket: web.WebSocketResponse, connection: HttpConnection) -> None:
        super().__init__(connection)
        self._socket = socket

    async def send(self, data: str | bytes) -> None:
        try:
            if isinstance(data, str):
                await self._socket.send_str(data)
            else:
                await self._socket.send_bytes(data)
        except (ConnectionError, RuntimeError) as error:
            raise TransportClosedError(str(error) or "the connection has ended") from None

    async def recv(self) -> str | bytes:
        try:
            message = await self._socket.receive()
        except (ConnectionError, RuntimeError) as error:  # e.g. a ping cannot be answered
            raise TransportClosedError(str(error)) from None
        self._connection.note_message_read()
        if message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
            data: str | bytes = message.data
            return data
        raise self._ended(message)

    async def close(self, timeout: float = 1.0) -> None:
        await close_or_abort(self._socket.close(), self.abort, timeout)

    def header(self, size: int, *, text: bool = False) -> bytes:
        first = _FINAL_FRAGMENT | (WSMsgType.TEXT if text else WSMsgType.BINARY)
        if size < 126:
            return struct.pack("!BB", first, size)
        if size < 2**16:
            return struct.pack("!BBH", first, 126, size)
        return struct.pack("!BBQ", first, 127, size)

    def _ended(self, message: WSMessage) -> TransportClosedError:
        """Return the error for a message with which aiohttp reports the end of the WebSocket."""
        if message.type is WSMsgType.CLOSE:
            return TransportClosedError(f"closed with code {message.data} {message.extra}".rstrip())
        if message.type is WSMsgType.ERROR:
            return TransportClosedError(f"not a valid frame: {message.data}")
        return TransportClosedError("the connection ended without a close frame")


HttpHandler = Callable[[web.BaseRequest, HttpConnection], Awaitable[web.StreamResponse]]
"""Answers a request that is no handshake of a WebSocket."""


async def _only_websockets(request: web.BaseRequest, _: HttpConnection) -> web.StreamResponse:
    """Refuse an HTTP request."""
    return web.Response(
        status=HTTPStatus.UPGRADE_REQUIRED,
        text="this port serves only WebSockets\n",
        headers={"Upgrade": "websocket"},
    )


async def serve_websocket(
    handler: Handler,
    host: str,
    port: int,
    *,
    max_size: int,
    before_handshake: Callable[[], Awaitable[object]] | None = None,
    local_pages_only: bool = False,
    respond: HttpHandler = _only_websockets,
) -> Listener:
    """Listen for WebSocket clients, and for HTTP requests on the same port.

    Args:
        port: the port to listen on; 0 takes a free port.
        max_size: largest frame that is read, in bytes.
        before_handshake: awaited before a client's handshake is answered, e.g. to delay it.
        local_pages_only: True to refuse web pages as clients, except pages of this machine.
        respond: answers a request that is no handshake; by default with status 426.

    Raises:
        OSError: the address or the port cannot be used.
    """

    async def serve_request(request: web.BaseRequest) -> web.StreamResponse:
        """Serve a WebSocket, or answer another HTTP request."""
        connection = None if request.transport is None else request.transport.get_protocol()
        if not isinstance(connection, HttpConnection):  # the connection has ended already
            return web.Response()
        # with some other headers, aiohttp would fail to answer, and log a traceback
        if not all(name.isascii() and value.isascii() for name, value in request.raw_headers):
            return web.Response(status=HTTPStatus.BAD_REQUEST, text="headers must be ASCII\n")
        if local_pages_only and not _is_local(request.headers.getall("Origin", [])):
            return web.Response(status=HTTPStatus.FORBIDDEN, text="web pages may not connect\n")
        try:
            connection.note_opened()
            if request.headers.get("Upgrade", "").lower() == "websocket":
                return await serve_socket(request, connection)
            return await respond(request, connection)
        except (web.HTTPException, ConnectionError):  # a bad handshake, or the client has gone
            raise
        except Exception:
            _LOG.exception("the request %s failed", request.path)
            raise

    async def serve_socket(
        request: web.BaseRequest, connection: HttpConnection
    ) -> web.StreamResponse:
        """Make the handshake, and run the handler until the WebSocket ends."""
        if before_handshake:
            await before_handshake()
        socket = web.WebSocketResponse(
            timeout=_CLOSE_TIMEOUT, compress=False, max_msg_size=max_size
        )
        await socket.prepare(request)
        connection.note_opened(max_size)
        await handler(WebSocketServerTransport(socket, connection))
        return socket

    http = web.Server(
        serve_request,
        logger=_SILENT,
        access_log=None,
        auto_decompress=False,
        keepalive_timeout=_KEEPALIVE_TIMEOUT,
    )
    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: HttpConnection(http()), host, port)
    return Listener(server, http)


_LOCAL_ORIGIN = re.compile(r"https?://(localhost|127\.[0-9.]+|\[::1\])(:\d+)?")
"""Origin of a web page of this machine."""


def _is_local(origins: list[str]) -> bool:
    """Return True for a request without an origin, or from a web page of this machine."""
    return all(map(_LOCAL_ORIGIN.fullmatch, origins))
