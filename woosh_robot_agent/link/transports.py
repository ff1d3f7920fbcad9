"""What carries frames: a WebSocket, or TCP with protobuf's delimited format; both ends of each."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import re
import struct
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI, WebSocketException
from websockets.frames import Opcode

from woosh_robot_agent.link.codecs.frames import FrameError
from woosh_robot_agent.link.config import LinkConfig
from woosh_robot_agent.link.timeouts import drop, settle, within

_ClientSocket: Any
_ws_connect: Any
_ws_serve: Any
try:  # websockets 13 and later
    from websockets.asyncio.client import ClientConnection as _ClientSocket
    from websockets.asyncio.client import connect as _ws_connect
    from websockets.asyncio.server import serve as _ws_serve

    _FACTORY = "create_connection"
except ImportError:  # as Ubuntu 24.04 has it
    from websockets.legacy.client import WebSocketClientProtocol as _ClientSocket
    from websockets.legacy.client import connect as _ws_connect
    from websockets.legacy.server import serve as _ws_serve

    _FACTORY = "create_protocol"

# Raw text: a frame that is not UTF-8 is one bad frame, not the end of the connection.
_RAW_TEXT: dict[str, Any] = (
    {"decode": False} if "decode" in inspect.signature(_ClientSocket.recv).parameters else {}
)
_NO_PROXY: dict[str, Any] = (
    {"proxy": None} if "proxy" in inspect.signature(_ws_connect).parameters else {}
)
_CHUNK = 256 * 1024
_PROGRESS = 1024
"""Bytes of an unfinished frame that are a sign of life: one that trickles in never ends."""
_LONGEST_MESSAGE = 2**31 - 1
"""Bytes of the largest protobuf message there can be."""
_TOO_BIG = 1009
_FINAL = 0x80
_DRAIN_POLL = 0.002


class TransportClosedError(Exception):
    """The connection ended; the text says how."""


class Transport(Protocol):
    """One open connection that carries whole frames."""

    peer: str
    """Address of the other end, for people."""

    @property
    def heard(self) -> float:
        """Loop time at which a part of a frame last came in; 0 before the first."""

    def backlog(self) -> int:
        """Number of bytes that were sent, but that the network has not taken yet."""

    async def send(self, data: str | bytes) -> None:
        """Hand one frame to the connection; waits while its buffer is full.

        Raises:
            TransportClosedError: the connection has ended.
        """

    def header(self, size: int, *, text: bool = False) -> bytes:
        """What stands before a frame of `size` bytes from the server's end.

        Args:
            size: up to 2^63 - 1.
            text: a text frame, where the transport has them; else a binary one.
        """

    async def send_raw(self, data: bytes) -> None:
        """Write bytes, with no frame around them, where a frame could begin.

        Waits while the buffer is full. It is for tests of the other end: bytes that are no frame
        may leave the connection useless.

        Raises:
            TransportClosedError: the connection has ended.
        """

    async def recv(self) -> str | bytes:
        """The next frame.

        Raises:
            TransportClosedError: the connection has ended.
            FrameError: a frame was skipped; the connection goes on.
        """

    async def ping(self) -> bool:
        """Wait for the other end's sign of life; False where the transport has no ping.

        Raises:
            TransportClosedError: the connection has ended.
        """

    async def close(self, timeout: float = 1.0) -> None:
        """Close in an orderly way, within `timeout` s, else at once."""

    def abort(self) -> None:
        """Drop the connection at once."""

    def pause(self) -> None:
        """Read nothing more from the socket, pings included, until `resume`."""

    def resume(self) -> None:
        """Read again."""


Handler = Callable[[Transport], Awaitable[None]]


class Listener:
    """A server's sockets.

    Attributes:
        port: The one it really has.
        addresses: Family and address of each socket.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self.addresses: list[tuple[int, Any]] = [
            (each.family, each.getsockname()) for each in server.sockets
        ]
        self.port: int = self.addresses[0][1][1]

    async def close(self) -> None:
        """Stop listening; connections that are open end with their handlers."""
        self._server.close()
        with contextlib.suppress(TimeoutError):
            await within(1.0, self._server.wait_closed())


async def open_transport(config: LinkConfig) -> Transport:
    """Connect to a chassis.

    Raises:
        OSError: nothing answers at the address, or not in time.
        TransportClosedError: what answers does not speak this transport.
    """
    made: list[Any] = []
    open_it = _open_websocket if config.transport == "websocket" else _open_tcp
    opening = asyncio.ensure_future(open_it(config, made))
    try:
        await asyncio.wait({opening}, timeout=config.connect_timeout)
        if not opening.done():
            raise TimeoutError(f"no connection within {config.connect_timeout:g} s")
        return opening.result()
    except BaseException:
        for socket in made:  # first: without it, websockets may wait for an orderly close
            if transport := getattr(socket, "transport", None):
                transport.abort()
        await drop(opening)
        raise


class _LocalOrigin:
    """Equals the origin of each web page of this machine; all releases of the library compare."""

    _PATTERN = re.compile(r"https?://(localhost|127\.[0-9.]+|\[::1\])(:\d+)?")

    def __eq__(self, origin: object) -> bool:
        return isinstance(origin, str) and bool(self._PATTERN.fullmatch(origin))

    __hash__ = None  # type: ignore[assignment]


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
        host: the address to listen at.
        port: 0 takes a free one.
        max_size: of a frame, in bytes.
        before: is waited for before a client's handshake is answered, 10 s at the most: then the
            client is dropped.
        local_pages_only: refuse clients that are web pages, but for those of this machine itself.
    """

    async def handle(socket: Any) -> None:
        await handler(WebSocketTransport(socket, raw_text=False))

    async def process_request(*_: Any) -> None:
        if before:
            await before()

    server = await _ws_serve(
        handle,
        host,
        port,
        max_size=max_size,
        compression=None,
        ping_interval=None,
        close_timeout=1.0,
        process_request=process_request,
        origins=[None, _LocalOrigin()] if local_pages_only else None,
    )
    return Listener(server)


async def serve_tcp(handler: Handler, host: str, port: int, *, max_size: int) -> Listener:
    """Listen for TCP clients; port 0 takes a free one."""

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await handler(TcpTransport(reader, writer, max_size))

    return Listener(await asyncio.start_server(handle, host, port))


class _Connect(_ws_connect):
    """The library's connecting, but without following redirects: to the chassis, or nowhere."""

    def process_redirect(self, exc: Exception) -> Exception:
        return exc

    def handle_redirect(self, uri: str) -> None:  # of websockets before 14
        raise InvalidHandshake(f"it redirects to {uri}")


class _Client(_ClientSocket):
    """The library's client, which also tells when a part of a frame has come in."""

    heard = 0.0
    _unheard = 0

    def data_received(self, data: bytes) -> None:
        self._unheard += len(data)
        if self._unheard >= _PROGRESS:
            self.heard, self._unheard = self.loop.time(), 0
        super().data_received(data)


async def _open_websocket(config: LinkConfig, made: list[Any]) -> Transport:
    def make(*args: Any, **options: Any) -> _Client:
        socket = _Client(*args, **options)
        made.append(socket)
        return socket

    try:
        socket = await _Connect(
            config.address,
            max_size=config.max_frame_size,
            compression=None,
            ping_interval=None,  # the connection pings by itself, and only when idle
            open_timeout=None,
            close_timeout=config.close_timeout,
            **{_FACTORY: make},
            **_NO_PROXY,
        )
    except (InvalidHandshake, InvalidURI) as error:
        raise TransportClosedError(f"not a WebSocket server: {error}") from None
    except (WebSocketException, EOFError) as error:
        raise TransportClosedError(f"the WebSocket did not open: {error}") from None
    return WebSocketTransport(socket, raw_text=True)


async def _open_tcp(config: LinkConfig, made: list[Any]) -> Transport:
    reader, writer = await asyncio.open_connection(config.ip, config.effective_port)
    made.append(writer)
    return TcpTransport(reader, writer, config.max_frame_size)


class WebSocketTransport:
    """A WebSocket, text and binary frames alike.

    Args:
        raw_text: give text frames as bytes, unchecked, where the library can.
    """

    def __init__(self, socket: Any, *, raw_text: bool) -> None:
        self._socket = socket
        self._recv_options = _RAW_TEXT if raw_text else {}
        self.peer = _peer(socket.transport)

    @property
    def heard(self) -> float:
        """See `Transport.heard`."""
        return getattr(self._socket, "heard", 0.0)

    def backlog(self) -> int:
        """See `Transport.backlog`."""
        return int(self._socket.transport.get_write_buffer_size())

    async def send(self, data: str | bytes) -> None:
        """See `Transport.send`."""
        try:
            await self._socket.send(data)
        except ConnectionClosed as error:
            raise TransportClosedError(_reason(error)) from None

    def header(self, size: int, *, text: bool = False) -> bytes:
        """See `Transport.header`."""
        first = _FINAL | (Opcode.TEXT if text else Opcode.BINARY)
        if size < 126:
            return struct.pack("!BB", first, size)
        if size < 2**16:
            return struct.pack("!BBH", first, 126, size)
        return struct.pack("!BBQ", first, 127, size)

    async def send_raw(self, data: bytes) -> None:
        """See `Transport.send_raw`."""
        transport = self._socket.transport
        transport.write(data)
        # The library's own waiting differs from release to release, and is not public.
        while transport.get_write_buffer_size() > _CHUNK and not transport.is_closing():
            await asyncio.sleep(_DRAIN_POLL)
        if transport.is_closing():
            raise TransportClosedError("the connection broke off without a close")

    async def recv(self) -> str | bytes:
        """See `Transport.recv`."""
        try:
            data: str | bytes = await self._socket.recv(**self._recv_options)
        except ConnectionClosed as error:
            raise TransportClosedError(_reason(error)) from None
        return data

    async def ping(self) -> bool:
        """See `Transport.ping`."""
        try:
            await (await self._socket.ping())
        except ConnectionClosed as error:
            raise TransportClosedError(_reason(error)) from None
        return True

    async def close(self, timeout: float = 1.0) -> None:
        """See `Transport.close`."""
        closing = asyncio.ensure_future(self._socket.close())
        try:
            await asyncio.wait({closing}, timeout=timeout)
        finally:
            self.abort()
            await settle(closing)

    def abort(self) -> None:
        """See `Transport.abort`."""
        self._socket.transport.abort()

    def pause(self) -> None:
        """See `Transport.pause`."""
        self._socket.transport.pause_reading()

    def resume(self) -> None:
        """See `Transport.resume`."""
        self._socket.transport.resume_reading()


class TcpTransport:
    """Frames in protobuf's delimited format: a varint length, then as many bytes."""

    def __init__(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, max_size: int
    ) -> None:
        self._reader = reader
        self._writer = writer
        self._max_size = max_size
        self._read_side: Any = writer.transport  # one object for both directions
        self._now = asyncio.get_running_loop().time
        self.peer = _peer(writer.transport)
        self.heard = 0.0

    def backlog(self) -> int:
        """See `Transport.backlog`."""
        return self._writer.transport.get_write_buffer_size()

    async def send(self, data: str | bytes) -> None:
        """See `Transport.send`."""
        frame = data.encode() if isinstance(data, str) else data
        await self.send_raw(self.header(len(frame)) + frame)

    def header(self, size: int, *, text: bool = False) -> bytes:
        """See `Transport.header`."""
        return varint(size)

    async def send_raw(self, data: bytes) -> None:
        """See `Transport.send_raw`."""
        try:
            self._writer.write(data)
            await self._writer.drain()
        except (OSError, RuntimeError) as error:
            raise TransportClosedError(str(error) or type(error).__name__) from None

    async def recv(self) -> str | bytes:
        """See `Transport.recv`."""
        try:
            size = await self._read_varint()
            if size > _LONGEST_MESSAGE:  # skipping it would last for ever
                raise TransportClosedError(f"a length of {size} bytes: not our format")
            if size > self._max_size:
                await self._skip(size)
                raise FrameError(
                    "oversize", f"{size} bytes, over max_frame_size, which is {self._max_size}"
                )
            if size <= _CHUNK:
                return await self._reader.readexactly(size)
            return await self._read_big(size)
        except asyncio.IncompleteReadError as error:
            where = "in the middle of a frame" if error.partial else "by the other end"
            raise TransportClosedError(f"closed {where}") from None
        except OSError as error:
            raise TransportClosedError(str(error) or type(error).__name__) from None

    async def ping(self) -> bool:
        """See `Transport.ping`; the delimited format has none."""
        return False

    async def close(self, timeout: float = 1.0) -> None:
        """See `Transport.close`."""
        self._writer.close()
        try:
            await within(timeout, self._writer.wait_closed())
        except OSError:  # a TimeoutError too
            pass
        finally:
            self.abort()

    def abort(self) -> None:
        """See `Transport.abort`."""
        self._writer.transport.abort()

    def pause(self) -> None:
        """See `Transport.pause`."""
        self._read_side.pause_reading()

    def resume(self) -> None:
        """See `Transport.resume`."""
        self._read_side.resume_reading()

    async def _read_varint(self) -> int:
        size = 0
        for shift in range(0, 64, 7):
            byte = (await self._reader.readexactly(1))[0]
            size |= (byte & 0x7F) << shift
            if byte < 0x80:
                return size
        raise TransportClosedError("a length that is no varint: not our format")

    async def _read_big(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            data += await self._reader.readexactly(min(size - len(data), _CHUNK))
            self.heard = self._now()
        return bytes(data)

    async def _skip(self, size: int) -> None:
        while size:
            size -= len(await self._reader.readexactly(min(size, _CHUNK)))
            self.heard = self._now()


def varint(value: int) -> bytes:
    """A number as protobuf writes it: seven bits a byte, the least first."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _peer(transport: Any) -> str:
    name = transport.get_extra_info("peername")
    return f"{name[0]}:{name[1]}" if isinstance(name, tuple) else "unknown"


def _reason(error: ConnectionClosed) -> str:
    close = error.rcvd or error.sent
    if close is None:
        return "the connection broke off without a close"
    text = f"closed with code {close.code} {close.reason}".rstrip()
    if close.code == _TOO_BIG:
        text += (
            " (the other end found a frame of ours too big)"
            if error.rcvd is not None and error.rcvd_then_sent is not False
            else " (a frame over the limit: raise max_frame_size)"
        )
    return text
