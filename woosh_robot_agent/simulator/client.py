"""One connected client: what it subscribed to, and what waits to be sent to it."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from functools import partial

from woosh_robot_agent.link.frames import Codec
from woosh_robot_agent.link.json_codec import JsonCodec
from woosh_robot_agent.link.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.transports import Transport, TransportClosedError
from woosh_robot_agent.simulator.hooks import Encoded, Outgoing

JSON: Codec = JsonCodec(defaults=True)
PROTOBUF: Codec = ProtobufCodec()


def codec_of(data: str | bytes) -> Codec:
    """The codec of a frame: text is JSON, bytes are protobuf."""
    return JSON if isinstance(data, str) else PROTOBUF


class Client:
    """The simulator's end of one connection.

    Args:
        transport: The open connection.
        max_outbox: How many frames may wait before the client is dropped as too slow.

    Attributes:
        topics: What it subscribed to, each with the codec of the subscription.
        queued: How many requests of it wait to be done.
    """

    def __init__(self, transport: Transport, max_outbox: int) -> None:
        self.transport = transport
        self.topics: dict[str, Codec] = {}
        self.queued = 0
        self._max_outbox = max_outbox
        self._outbox: deque[Encoded] = deque()
        self._delayed: dict[object, tuple[asyncio.TimerHandle, Encoded]] = {}
        self._held = 0
        self._filled = asyncio.Event()
        self._open = True

    @property
    def waiting(self) -> int:
        """How many requests of it wait to be done, or for their answers to be let go."""
        return self.queued + self._held + len(self._delayed)

    @property
    def backlog(self) -> int:
        """How many frames wait to be written."""
        return len(self._outbox)

    def send(self, frame: Encoded) -> None:
        """Queue a frame; never waits."""
        if self._room():
            self._outbox.append(frame)
            self._filled.set()

    def send_as(self, frame: Outgoing, data: Encoded) -> None:
        """Queue the encoded `frame` when its `hold` and then its `delay` let it go."""
        if not frame.hold:
            self._send_after(frame.delay, data)
        elif self._room():
            self._held += 1
            frame.hold(partial(self._let_go, frame.delay, data))

    def release(self) -> None:
        """Queue at once what is delayed, in the order in which it would have come."""
        delayed = sorted(self._delayed.values(), key=lambda item: item[0].when())
        self._delayed.clear()
        for timer, data in delayed:
            timer.cancel()
            self.send(data)

    def drop(self) -> None:
        """End the connection at once, as a broken cable would."""
        self.forget()
        self.transport.abort()

    def forget(self) -> None:
        """Send nothing any more."""
        self._open = False
        self._outbox.clear()
        for timer, _ in self._delayed.values():
            timer.cancel()
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
                if callable(frame):
                    await frame(self.transport)
                else:
                    await self.transport.send(frame)
        self._open = False

    def _room(self) -> bool:
        """Whether one more frame may wait; a client for which none may is dropped."""
        if self._open and self._held + len(self._delayed) + len(self._outbox) >= self._max_outbox:
            self.drop()
        return self._open

    def _let_go(self, delay: float, data: Encoded) -> None:
        self._held -= 1
        self._send_after(delay, data)

    def _send_after(self, seconds: float, data: Encoded) -> None:
        if not seconds:
            self.send(data)
        elif self._room():
            loop = asyncio.get_running_loop()
            key = object()
            self._delayed[key] = loop.call_later(seconds, self._due, key), data

    def _due(self, key: object) -> None:
        _, data = self._delayed.pop(key)
        self.send(data)
