"""Interface of a transport, and its error."""

from __future__ import annotations

from typing import Any, Protocol

CHUNK = 256 * 1024
"""Size of the pieces in which large frames are read and written, in bytes."""


class TransportClosedError(Exception):
    """The connection ended; the text says how."""


class Transport(Protocol):
    """One open connection that carries whole frames."""

    peer: str
    """Address of the other end, for logs."""

    @property
    def progress_at(self) -> float:
        """Loop time at which a part of an unfinished frame last arrived; 0 before the first."""

    @property
    def received(self) -> int:
        """Number of bytes received so far, those of an unfinished frame included."""

    @property
    def waited(self) -> bool:
        """True if the last frame arrived after `recv` was called; False if that is not known."""

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

    async def ping(self) -> bool:
        """Ping the other end and wait for its pong; False if the transport has no ping.

        Raises:
            TransportClosedError: the connection has ended.
        """

    async def close(self, timeout: float = 1.0) -> None:
        """Close in an orderly way within `timeout` seconds, otherwise abort."""

    def abort(self) -> None:
        """Drop the connection at once."""


def peer_address(transport: Any) -> str:
    """Return the address of an asyncio transport's other end."""
    name = transport.get_extra_info("peername")
    return f"{name[0]}:{name[1]}" if isinstance(name, tuple) else "unknown"
