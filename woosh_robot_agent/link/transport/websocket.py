"""WebSocket transport."""

from __future__ import annotations

import asyncio
from typing import Any

from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI, WebSocketException

from woosh_robot_agent.link.config import LinkConfig
from woosh_robot_agent.link.timeouts import wait_then_cancel
from woosh_robot_agent.link.transport.base import TransportClosedError, peer_address
from woosh_robot_agent.link.transport.websockets_compat import RAW_TEXT, ClientSocket, Connect

_PROGRESS = 1024
"""Number of bytes of an unfinished frame that count as a sign of life. Fewer do not: a frame that
trickles in must not keep the link alive forever."""
_MESSAGE_TOO_BIG = 1009
"""Close code for a frame that is larger than the receiver accepts."""


class WebSocketTransport:
    """A WebSocket that carries text and binary frames.

    Args:
        socket: an open connection of the `websockets` library.
        raw_text: return text frames as bytes, without a UTF-8 check, if the library can.
    """

    def __init__(self, socket: Any, *, raw_text: bool) -> None:
        self._socket = socket
        self._recv_options = RAW_TEXT if raw_text else {}
        self.peer = peer_address(socket.transport)
        self.waited = False

    @property
    def progress_at(self) -> float:
        return getattr(self._socket, "progress_at", 0.0)

    @property
    def received(self) -> int:
        return getattr(self._socket, "received", 0)

    def backlog(self) -> int:
        return int(self._socket.transport.get_write_buffer_size())

    async def send(self, data: str | bytes) -> None:
        try:
            await self._socket.send(data)
        except ConnectionClosed as error:
            raise TransportClosedError(_reason(error)) from None

    async def recv(self) -> str | bytes:
        before = self.received
        try:
            data: str | bytes = await self._socket.recv(**self._recv_options)
        except ConnectionClosed as error:
            raise TransportClosedError(_reason(error)) from None
        self.waited = self.received != before
        return data

    async def ping(self) -> bool:
        try:
            await (await self._socket.ping())
        except ConnectionClosed as error:
            raise TransportClosedError(_reason(error)) from None
        return True

    async def close(self, timeout: float = 1.0) -> None:
        closing = asyncio.ensure_future(self._socket.close())
        try:
            await asyncio.wait({closing}, timeout=timeout)
        finally:
            self.abort()
            await wait_then_cancel(closing)

    def abort(self) -> None:
        self._socket.transport.abort()


async def open_websocket(config: LinkConfig, made: list[Any]) -> WebSocketTransport:
    """Connect to a chassis by WebSocket.

    Args:
        config: address and limits.
        made: list to which the socket is added as soon as it exists, so that the caller can abort
            it.

    Raises:
        OSError: nothing answers at the address.
        TransportClosedError: the other end does not speak WebSocket.
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
        raise TransportClosedError(f"not a WebSocket server: {error}") from None
    except (WebSocketException, EOFError) as error:
        raise TransportClosedError(f"the WebSocket did not open: {error}") from None
    return WebSocketTransport(socket, raw_text=True)


class _ClientSocket(ClientSocket):
    """The library's client connection; it also notes how much arrives, and when."""

    progress_at = 0.0
    received = 0
    _bytes_since_progress = 0

    def data_received(self, data: bytes) -> None:
        self.received += len(data)
        self._bytes_since_progress += len(data)
        if self._bytes_since_progress >= _PROGRESS:
            self.progress_at, self._bytes_since_progress = self.loop.time(), 0
        super().data_received(data)


def _reason(error: ConnectionClosed) -> str:
    close = error.rcvd or error.sent
    if close is None:
        return "the connection ended without a close frame"
    text = f"closed with code {close.code} {close.reason}".rstrip()
    if close.code == _MESSAGE_TOO_BIG:
        text += (
            " (a frame from this side is too large for the other end)"
            if error.rcvd is not None and error.rcvd_then_sent is not False
            else " (a frame is over the limit; raise max_frame_size)"
        )
    return text
