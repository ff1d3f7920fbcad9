"""The server's side of one client: its subscriptions and its queue of outgoing frames."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Awaitable, Callable

from woosh_robot_agent.link.codecs.frames import Codec
from woosh_robot_agent.link.server.base import ServerTransport
from woosh_robot_agent.link.transport.base import TransportClosedError

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
