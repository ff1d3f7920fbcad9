"""One connected client: what it subscribed to, and what waits to be sent to it."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from functools import partial
from typing import NamedTuple

from woosh_robot_agent.link.codecs.frames import Codec
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.transports import Transport, TransportClosedError
from woosh_robot_agent.simulator.serving.hooks import Encoded, Outgoing

JSON: Codec = JsonCodec(defaults=True)
PROTOBUF: Codec = ProtobufCodec()


def codec_of(data: str | bytes) -> Codec:
    """The codec of a frame: text is JSON, bytes are protobuf."""
    return JSON if isinstance(data, str) else PROTOBUF


_MAX_BYTES = 64 * 1024 * 1024
"""Bytes that may wait for a client when one more frame comes, be they few frames or many."""


class _Delayed(NamedTuple):
    timer: asyncio.TimerHandle
    frame: Outgoing
    data: Encoded


class Client:
    """The simulator's end of one connection.

    Args:
        transport: The open connection.
        max_outbox: How many frames may wait before the client is dropped as too slow.

    Attributes:
        topics: What it subscribed to, each with the codec of the subscription.
        spoke: It has sent something since it connected.
        waiting: How many of its requests wait, to be done or for their answers to be let go.
    """

    def __init__(self, transport: Transport, max_outbox: int) -> None:
        self.transport = transport
        self.topics: dict[str, Codec] = {}
        self.spoke = False
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
        """How many frames wait to be written."""
        return len(self._outbox)

    def send(self, frame: Encoded) -> None:
        """Queue a frame; never waits."""
        if self._room():
            self._outbox.append(frame)
            self._outbox_bytes += _size(frame)
            self._filled.set()

    def send_as(self, frame: Outgoing, data: Encoded) -> None:
        """Queue the encoded `frame` when its `hold` and then its `delay` let it go."""
        if not frame.hold:
            self._send_after(frame, data)
        elif self._room():
            self._held += 1
            self.waiting += frame.is_answer
            frame.hold(self, partial(self._let_go, frame, data))

    def release(self) -> None:
        """Queue at once what is delayed, in the order in which it would have come."""
        for key in sorted(self._delayed, key=lambda key: self._delayed[key].timer.when()):
            self._delayed[key].timer.cancel()
            self._due(key)

    @property
    def unsent(self) -> int:
        """What is not sent yet: frames in the queue, and bytes that the network has not taken."""
        return len(self._outbox) + self.transport.backlog()

    def drop(self) -> None:
        """End the connection at once, as a broken cable would."""
        self.forget()
        self.transport.abort()

    def forget(self) -> None:
        """Send nothing any more."""
        self._open = False
        self._outbox.clear()
        self._outbox_bytes = 0
        for delayed in self._delayed.values():
            delayed.timer.cancel()
        self._delayed.clear()

    async def write(self, running: asyncio.Event) -> None:
        """Send what is queued, for as long as the connection lasts and `running` is set."""
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

    def _room(self) -> bool:
        """Whether one more frame may wait; a client for which none may is dropped."""
        waiting = self._held + len(self._delayed) + len(self._outbox)
        if self._open and (waiting >= self._max_outbox or self._outbox_bytes > _MAX_BYTES):
            self.drop()
        return self._open

    def _let_go(self, frame: Outgoing, data: Encoded) -> None:
        self._held -= 1
        self.waiting -= frame.is_answer
        self._send_after(frame, data)

    def _send_after(self, frame: Outgoing, data: Encoded) -> None:
        if not frame.delay:
            self.send(data)
        elif self._room():
            self.waiting += frame.is_answer
            key = object()
            timer = asyncio.get_running_loop().call_later(frame.delay, self._due, key)
            self._delayed[key] = _Delayed(timer, frame, data)

    def _due(self, key: object) -> None:
        delayed = self._delayed.pop(key)
        self.waiting -= delayed.frame.is_answer
        self.send(delayed.data)


def _size(frame: Encoded) -> int:
    """About how many bytes a frame takes; what a fault writes by itself takes none."""
    return 0 if callable(frame) else len(frame)
