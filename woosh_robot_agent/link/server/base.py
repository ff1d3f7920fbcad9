"""Interface of a server's transport: a transport that can also write raw bytes and stop reading."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Protocol

from woosh_robot_agent.link.transport.base import Transport


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
