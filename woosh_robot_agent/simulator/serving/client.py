"""A connected client: its subscriptions and its queue of outgoing frames."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from functools import partial
from typing import NamedTuple

from woosh_robot_agent.link.codecs.frames import Codec
from woosh_robot_agent.link.server.base import ServerTransport
from woosh_robot_agent.link.transport.base import TransportClosedError
from woosh_robot_agent.simulator.serving.hooks import Encoded, Outgoing

_MAX_BYTES = 64 * 1024 * 1024
"""Maximum number of queued bytes with which a client still gets another frame."""


class _Delayed(NamedTuple):
    timer: asyncio.TimerHandle
    frame: Outgoing
    data: Encoded


class Client:
    """The simulator's end of one connection.

    Args:
        transport: The open connection.
        max_outbox: Maximum number of frames that wait. A client that exceeds it is dropped.

    Attributes:
        topics: Its subscriptions: topics with the codecs in which it subscribed.
        has_sent: It has sent something since it connected.
        waiting: Number of its requests that wait to be executed, or whose answers are held back.
    """

    def __init__(self, transport: ServerTransport, max_outbox: int) -> None:
        self.transport = transport
        self.topics: dict[str, Codec] = {}
        self.has_sent = False
        self.waiting = 0
        self._max_outbox = max_outbox
        self._outbox: deque[Encoded] = deque()
        self._outbox_bytes = 0
        self._delayed: dict[object, _Delayed] = {}
        self._held = 0
        self._filled = asyncio.Event()
        self._open = True

    @property
    def backlog(self) -> int:
        """Number of frames that wait to be written."""
        return len(self._outbox)

    def send(self, frame: Encoded) -> None:
        """Queue a frame without waiting."""
        if self._has_room():
            self._outbox.append(frame)
            self._outbox_bytes += _size(frame)
            self._filled.set()

    def send_as(self, frame: Outgoing, data: Encoded) -> None:
        """Queue the encoded `frame` once its `hold` releases it and its `delay` has passed."""
        if not frame.hold:
            self._send_after(frame, data)
        elif self._has_room():
            self._held += 1
            self.waiting += frame.is_answer
            frame.hold(self, partial(self._release, frame, data))

    def release(self) -> None:
        """Queue all delayed frames at once, in the order of their times."""
        for key in sorted(self._delayed, key=lambda key: self._delayed[key].timer.when()):
            self._delayed[key].timer.cancel()
            self._queue_delayed(key)

    @property
    def unsent(self) -> int:
        """Frames in the queue plus bytes in the buffer of the transport."""
        return len(self._outbox) + self.transport.backlog()

    def drop(self) -> None:
        """Abort the connection, as a broken cable would."""
        self.forget()
        self.transport.abort()

    def forget(self) -> None:
        """Discard all queued frames, and send nothing further."""
        self._open = False
        self._outbox.clear()
        self._outbox_bytes = 0
        for delayed in self._delayed.values():
            delayed.timer.cancel()
        self._delayed.clear()

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

    def _has_room(self) -> bool:
        """Return True if another frame may be queued. Otherwise drop the client."""
        waiting = self._held + len(self._delayed) + len(self._outbox)
        if self._open and (waiting >= self._max_outbox or self._outbox_bytes > _MAX_BYTES):
            self.drop()
        return self._open

    def _release(self, frame: Outgoing, data: Encoded) -> None:
        self._held -= 1
        self.waiting -= frame.is_answer
        self._send_after(frame, data)

    def _send_after(self, frame: Outgoing, data: Encoded) -> None:
        if not frame.delay:
            self.send(data)
        elif self._has_room():
            self.waiting += frame.is_answer
            key = object()
            timer = asyncio.get_running_loop().call_later(frame.delay, self._queue_delayed, key)
            self._delayed[key] = _Delayed(timer, frame, data)

    def _queue_delayed(self, key: object) -> None:
        delayed = self._delayed.pop(key)
        self.waiting -= delayed.frame.is_answer
        self.send(delayed.data)


def _size(frame: Encoded) -> int:
    """Return the approximate size of a frame in bytes; 0 for one that a fault writes itself."""
    return 0 if callable(frame) else len(frame)
