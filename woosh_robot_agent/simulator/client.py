"""One connected client: what it subscribed to, and what waits to be sent to it."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque

from woosh_robot_agent.link.frames import Codec
from woosh_robot_agent.link.json_codec import JsonCodec
from woosh_robot_agent.link.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.transports import Transport, TransportClosedError

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
    """

    def __init__(self, transport: Transport, max_outbox: int) -> None:
        self.transport = transport
        self.topics: dict[str, Codec] = {}
        self._max_outbox = max_outbox
        self._outbox: deque[str | bytes] = deque()
        self._filled = asyncio.Event()
        self._open = True

    def send(self, frame: str | bytes) -> None:
        """Queue a frame; never waits."""
        if not self._open:
            return
        if len(self._outbox) >= self._max_outbox:
            self.drop()
            return
        self._outbox.append(frame)
        self._filled.set()

    @property
    def backlog(self) -> int:
        """What is not sent yet: frames in the queue, and bytes that the network has not taken."""
        return len(self._outbox) + self.transport.backlog()

    def drop(self) -> None:
        """End the connection at once, as a broken cable would."""
        self._open = False
        self._outbox.clear()
        self.transport.abort()

    async def write(self, running: asyncio.Event) -> None:
        """Send what is queued, for as long as the connection lasts and `running` is set."""
        with contextlib.suppress(TransportClosedError):
            while self._open:
                await self._filled.wait()
                await running.wait()
                if self._outbox:
                    await self.transport.send(self._outbox.popleft())
                else:
                    self._filled.clear()
        self._open = False
