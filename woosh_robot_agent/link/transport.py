"""Client side of the transports: connections that carry whole frames, over WebSocket or TCP."""

from __future__ import annotations

import asyncio
import inspect
import math
import socket
from collections.abc import Callable
from typing import Any, Protocol

from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI, WebSocketException
from websockets.frames import Frame, Opcode

from woosh_robot_agent.link.config import LinkConfig
from woosh_robot_agent.link.frames import FrameError
from woosh_robot_agent.link.tasks import (
    LARGE,
    abort_transport,
    cancel_and_wait,
    close_or_abort,
    drop_unsent_at_end,
    retrieve_exception,
    run_with_timeout,
)
from woosh_robot_agent.sentences import Sentence

_NO_WEBSOCKET = Sentence("not a WebSocket server: {error}")
_NOT_OPEN = Sentence("the WebSocket did not open: {error}")
_TOO_LATE = Sentence("no connection within {seconds} s")
_CLOSED = Sentence("closed by the other end")()
_NO_CLOSE = Sentence("the connection ended without a close frame")()
_CODE = Sentence("closed with code {code}")
_SENT_TOO_BIG = Sentence("{text} (a frame from this side is too large for the other end)")
_GOT_TOO_BIG = Sentence(
    "{text} (a frame is over the limit; raise max_frame_size, a parameter of the agent)"
)
_CUT = Sentence("closed in the middle of a frame")()
CHUNK = 256 * 1024
"""Size of the pieces in which large frames are read and written, in bytes."""


class TransportClosedError(Exception):
    """The connection ended; the text says how."""


class FrameConnection(Protocol):
    """One end of an open connection that carries whole frames."""

    peer: str
    """Address of the other end, for logs."""

    def backlog(self) -> int:
        """Return the number of accepted bytes that still wait in the write buffer."""

    async def send(self, data: str | bytes) -> None:
        """Hand one frame to the connection; waits while its buffer is full.

        Raises:
            TransportClosedError: the connection has ended.
        """

    async def recv(self) -> str | bytes:
        """Wait for the next frame and return it.

        Raises:
            TransportClosedError: the connection has ended.
            FrameError: a frame was skipped; the connection goes on.
        """

    async def close(self, timeout: float = 1.0) -> None:
        """Close in an orderly way within `timeout` seconds, otherwise abort."""

    def abort(self) -> None:
        """Drop the connection at once."""


class Transport(FrameConnection, Protocol):
    """The client's end of a connection, which also pings, and reports the progress of reception."""

    async def ping(self) -> bool:
        """Ping the other end and wait for its pong; False if the transport has no ping.

        Raises:
            TransportClosedError: the connection has ended.
        """

    @property
    def progress_at(self) -> float:
        """Loop time at which another `_PROGRESS` bytes had arrived; 0 before the first ones."""

    @property
    def received(self) -> int:
        """Number of bytes received so far, including the bytes of an unfinished frame.

        Over TCP, the sizes before the frames are not counted.
        """

    @property
    def waited(self) -> bool:
        """True if the last call of `recv` had to wait for its frame; False if that is not known."""

    def take_at_once(self, take: Callable[[bytes], None]) -> None:
        """Pass frames to a function as they arrive, which saves a turn of the event loop.

        A frame is passed on if it is small and unfragmented, arrives while `recv` waits, and is the
        first of the frames that arrive together. `recv` returns all other frames, in order. If the
        transport does not support this, `recv` returns all frames.

        Args:
            take: called with a frame; must not raise.
        """


def peer_address(transport: Any) -> str:
    """Return the address of an asyncio transport's other end."""
    name = transport.get_extra_info("peername")
    return f"{name[0]}:{name[1]}" if isinstance(name, tuple) else "unknown"


ClientSocket: Any
_connect: Any
try:  # websockets 13 and later
    from websockets.asyncio.client import ClientConnection as ClientSocket
    from websockets.asyncio.client import connect as _connect

    _FACTORY_OPTION = "create_connection"
except ImportError:
    from websockets.legacy.client import WebSocketClientProtocol as ClientSocket
    from websockets.legacy.client import connect as _connect

    _FACTORY_OPTION = "create_protocol"
"""Option of `connect` that sets the class of the connection."""

RAW_TEXT: dict[str, Any] = (
    {"decode": False} if "decode" in inspect.signature(ClientSocket.recv).parameters else {}
)
"""Options of `recv` that return a text frame as bytes, where this release of websockets has them.
Without them, websockets ends the connection at a text frame that is not UTF-8."""
_NO_PROXY: dict[str, Any] = (
    {"proxy": None} if "proxy" in inspect.signature(_connect).parameters else {}
)
"""Options of `connect` that turn proxies off. Releases without this option use no proxy."""


class Connect(_connect):
    """`websockets.connect` that follows no redirects and uses no proxy.

    Args:
        factory: makes the client's socket object.
        **options: other options of `websockets.connect`.
    """

    def __init__(self, uri: str, *, factory: Any, **options: Any) -> None:
        super().__init__(uri, **{_FACTORY_OPTION: factory}, **_NO_PROXY, **options)

    def process_redirect(self, exc: Exception) -> Exception:
        """Refuse a redirect; called by websockets 14 and later, which then raise `exc`."""
        return exc

    def handle_redirect(self, uri: str) -> None:
        """Refuse a redirect; called by websockets before 14."""
        raise InvalidHandshake(f"it redirects to {uri}")


_PROGRESS = 1024
"""Number of bytes of an unfinished frame that count as a sign of life. Fewer do not count: a frame
that trickles in must not keep the link alive forever."""
_LARGEST_MESSAGE = 2**31 - 1
"""Maximum size of a protobuf message, in bytes."""


class TcpTransport:
    """A `Transport` over TCP that carries delimited frames: the size as a varint, then the frame.

    Args:
        max_size: largest frame that is read, in bytes. For a larger one, `recv` skips the frame and
            raises a FrameError; one of more than 2 GiB ends the connection.
    """

    def __init__(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, max_size: int
    ) -> None:
        self._reader = reader
        self._writer = writer
        self._max_size = max_size
        self._now = asyncio.get_running_loop().time
        self.peer = peer_address(writer.transport)
        self.progress_at = 0.0
        self._bytes_since_progress = 0
        """Number of bytes of the current frame that arrived after `progress_at`."""
        self.received = 0
        self.waited = False  # always: it is not known over TCP

    def backlog(self) -> int:
        return self._writer.transport.get_write_buffer_size()

    async def send(self, data: str | bytes) -> None:
        frame = data.encode() if isinstance(data, str) else data
        await self._write(varint(len(frame)) + frame)

    async def recv(self) -> str | bytes:
        try:
            size = await self._read_varint()
            self._bytes_since_progress = 0
            if size > _LARGEST_MESSAGE:  # skipping it would take forever
                raise TransportClosedError(f"not delimited protobuf: frame of {size} bytes")
            if size > self._max_size:
                await self._skip(size)
                raise FrameError(
                    "oversize", f"{size} bytes are more than max_frame_size, {self._max_size}"
                )
            data = bytearray()
            while len(data) < size:
                data += await self._read_part(size - len(data))
            return bytes(data)
        except asyncio.IncompleteReadError as error:
            raise TransportClosedError(_CUT if error.partial else _CLOSED) from None
        except OSError as error:
            raise TransportClosedError(str(error) or type(error).__name__) from None

    def take_at_once(self, take: Callable[[bytes], None]) -> None:
        pass  # not supported: `recv` returns all frames

    async def ping(self) -> bool:
        return False  # delimited frames have no ping

    async def close(self, timeout: float = 1.0) -> None:
        try:
            # like `drop_unsent_at_end`, but the last bytes get some time to arrive
            self._writer.get_extra_info("socket").setsockopt(
                socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, math.ceil(timeout * 1000)
            )
            self._writer.close()
            await run_with_timeout(timeout, self._writer.wait_closed())
        except OSError:  # includes TimeoutError
            pass
        finally:
            self.abort()

    def abort(self) -> None:
        drop_unsent_at_end(self._writer.transport)
        abort_transport(self._writer.transport)

    async def _write(self, data: bytes) -> None:
        try:
            self._writer.write(data)
            await self._writer.drain()
        except (OSError, RuntimeError) as error:
            raise TransportClosedError(str(error) or type(error).__name__) from None

    async def _read_varint(self) -> int:
        size = 0
        for shift in range(0, 64, 7):
            byte = (await self._reader.readexactly(1))[0]
            size |= (byte & 0x7F) << shift
            if byte < 0x80:
                return size
        raise TransportClosedError("not delimited protobuf: the frame length is not a varint")

    async def _read_part(self, size: int) -> bytes:
        """Return the next bytes of an unfinished frame, of which `size` bytes are missing."""
        part = await self._reader.read(min(size, CHUNK))
        if not part:
            raise TransportClosedError(_CUT)
        self.received += len(part)
        self._bytes_since_progress += len(part)
        if self._bytes_since_progress >= _PROGRESS:
            self.progress_at, self._bytes_since_progress = self._now(), 0
        return part

    async def _skip(self, size: int) -> None:
        """Read and discard the next `size` bytes."""
        while size:
            size -= len(await self._read_part(size))


async def open_tcp(config: LinkConfig, made: list[Any]) -> TcpTransport:
    """Connect to a chassis by TCP.

    Adds the stream writer to `made`, so that the caller can abort the connection.

    Raises:
        OSError: nothing answers at the address.
    """
    reader, writer = await asyncio.open_connection(config.ip, config.effective_port)
    made.append(writer)
    return TcpTransport(reader, writer, config.max_frame_size)


def varint(value: int) -> bytes:
    """Return a number as a protobuf varint: seven bits per byte, the least significant first."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


_MESSAGE_STARTS = (Opcode.TEXT, Opcode.BINARY)
"""Opcodes of the first frame of a message."""
_MESSAGE_TOO_BIG = 1009
"""Close code for a frame that is larger than the receiver accepts."""


class WebSocketTransport:
    """A `Transport` over WebSocket; `recv` returns text as bytes if the library can do so."""

    def __init__(self, socket: _ClientSocket) -> None:
        self._socket = socket
        self.peer = peer_address(socket.transport)
        self.waited = False

    @property
    def progress_at(self) -> float:
        return self._socket.progress_at

    @property
    def received(self) -> int:
        return self._socket.received

    def backlog(self) -> int:
        return int(self._socket.transport.get_write_buffer_size())

    async def send(self, data: str | bytes) -> None:
        try:
            await self._socket.send(data)
        except ConnectionClosed as error:
            raise TransportClosedError(_reason(error)) from None

    async def recv(self) -> str | bytes:
        before = self.received
        self._socket.reader_waits = True
        try:
            data: str | bytes = await self._socket.recv(**RAW_TEXT)
        except ConnectionClosed as error:
            raise TransportClosedError(_reason(error)) from None
        finally:
            self._socket.reader_waits = False
        self._socket.queued -= 1
        self.waited = self.received != before  # otherwise the frame had arrived already
        return data

    def take_at_once(self, take: Callable[[bytes], None]) -> None:
        self._socket.take = take

    async def ping(self) -> bool:
        try:
            pong = await self._socket.ping()
            pong.add_done_callback(retrieve_exception)
            # not `await pong`, which a cancellation of this call would cancel, too: up to
            # websockets 14.1, the arrival of a cancelled pong ends the connection
            await asyncio.wait({pong})
            pong.result()
        except ConnectionClosed as error:
            raise TransportClosedError(_reason(error)) from None
        return True

    async def close(self, timeout: float = 1.0) -> None:
        # an answer to the close frame means that all before it has arrived
        drop_unsent_at_end(self._socket.transport)
        await close_or_abort(self._socket.close(), self.abort, timeout)

    def abort(self) -> None:
        drop_unsent_at_end(self._socket.transport)
        abort_transport(self._socket.transport)


async def open_websocket(config: LinkConfig, made: list[Any]) -> WebSocketTransport:
    """Connect to a chassis by WebSocket.

    Args:
        config: address and limits.
        made: list to which this adds the socket as soon as it exists, so that the caller can abort
            the connection.

    Raises:
        OSError: nothing answers at the address.
        TransportClosedError: the other end does not speak WebSocket, or the connection ended
            during the handshake.
    """

    def make(*args: Any, **options: Any) -> _ClientSocket:
        socket = _ClientSocket(*args, **options)
        made.append(socket)
        return socket

    try:
        socket = await Connect(
            config.address,
            factory=make,
            max_size=config.max_frame_size,
            compression=None,
            ping_interval=None,  # `Liveness` pings, and only when idle
            open_timeout=None,
            close_timeout=config.close_timeout,
        )
    except (InvalidHandshake, InvalidURI) as error:
        raise TransportClosedError(_NO_WEBSOCKET(error=str(error))) from None
    except (WebSocketException, EOFError) as error:
        raise TransportClosedError(_NOT_OPEN(error=str(error))) from None
    return WebSocketTransport(socket)


class _ClientSocket(ClientSocket):
    """A client connection of `websockets` that counts bytes, and passes small frames to `take`.

    This saves the turn of the event loop in which the reader of `recv` wakes up. `take` gets a
    frame only while the reader waits and no earlier message is queued, so that the order is kept.
    Of frames that arrive together, it gets only the first: the reader lets other tasks run between
    frames.

    Attributes:
        progress_at: loop time at which another `_PROGRESS` bytes had arrived; 0 before that.
        received: number of bytes received so far, including the bytes of an unfinished frame.
        take: function that gets small frames; None if `recv` returns all frames.
        reader_waits: True while `recv` waits.
        queued: number of messages that `recv` will return, an unfinished one included.
    """

    progress_at = 0.0
    received = 0
    take: Callable[[bytes], None] | None = None
    reader_waits = False
    queued = 0
    _bytes_since_progress = 0
    """Number of bytes received after `progress_at`."""
    _is_first = True
    """True while no message has begun in the bytes that arrived last."""

    def data_received(self, data: bytes) -> None:
        self.received += len(data)
        self._bytes_since_progress += len(data)
        if self._bytes_since_progress >= _PROGRESS:
            self.progress_at, self._bytes_since_progress = self.loop.time(), 0
        self._is_first = True
        super().data_received(data)

    def process_event(self, event: Any) -> None:
        """Pass a frame to `take` under the conditions of `Transport.take_at_once`, else queue it.

        Called by websockets 13 and later.
        """
        if isinstance(event, Frame) and event.opcode in _MESSAGE_STARTS:
            is_first, self._is_first = self._is_first, False
            is_awaited = is_first and self.reader_waits and not self.queued
            is_small = event.fin and len(event.data) < LARGE
            if self.take is not None and is_awaited and is_small:
                self.take(bytes(event.data))
                return
            self.queued += 1
        super().process_event(event)


def _reason(error: ConnectionClosed) -> str:
    """Return how a WebSocket ended."""
    close = error.rcvd or error.sent
    if close is None:
        return _NO_CLOSE
    text = _CODE(code=f"{close.code} {close.reason}".rstrip())
    if close.code == _MESSAGE_TOO_BIG:
        # the end that refuses the frame sends the code first, and the other end repeats it
        by_other = error.rcvd is not None and error.rcvd_then_sent is not False
        return (_SENT_TOO_BIG if by_other else _GOT_TOO_BIG)(text=text)
    return text


async def open_transport(config: LinkConfig) -> Transport:
    """Connect to a chassis.

    Raises:
        OSError: nothing answers at the address, or not in time.
        TransportClosedError: the other end does not speak WebSocket, or ended the connection during
            the handshake; never over TCP, which has none.
    """
    made: list[Any] = []
    opener = open_websocket if config.transport == "websocket" else open_tcp
    opening: asyncio.Future[Transport] = asyncio.ensure_future(opener(config, made))
    try:
        await asyncio.wait({opening}, timeout=config.connect_timeout)
        if not opening.done():
            raise TimeoutError(_TOO_LATE(seconds=f"{config.connect_timeout:g}"))
        return opening.result()
    except BaseException:
        for socket in made:  # first: otherwise websockets may wait for an orderly close
            if transport := getattr(socket, "transport", None):
                abort_transport(transport)
        await cancel_and_wait(opening)
        raise
