"""A client of the simulator, whose frames can be delayed and held back."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import NamedTuple

from woosh_robot_agent.link.server.base import ServerTransport
from woosh_robot_agent.link.server.outbox import ConnectedClient, Encoded
from woosh_robot_agent.simulator.serving.hooks import Outgoing


class _Delayed(NamedTuple):
    """A frame whose delay has not passed, with its encoded form."""

    timer: asyncio.TimerHandle
    frame: Outgoing
    data: Encoded


class Client(ConnectedClient):
    """The simulator's end of one connection.

    Args:
        transport: The open connection.
        max_outbox: Maximum number of frames that wait. A client that exceeds it is dropped.

    Attributes:
        has_sent: The client has sent at least one frame.
        waiting: Number of requests that wait to be executed or whose answers are held back.
    """

    def __init__(self, transport: ServerTransport, max_outbox: int) -> None:
        super().__init__(transport, max_outbox)
        self.has_sent = False
        self.waiting = 0
        self._delayed: dict[object, _Delayed] = {}
        """Delayed frames, by a unique key each."""
        self._held = 0
        """Number of frames that are held back."""

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

    def forget(self) -> None:
        super().forget()
        for delayed in self._delayed.values():
            delayed.timer.cancel()
        self._delayed.clear()

    def _waiting_frames(self) -> int:
        return super()._waiting_frames() + self._held + len(self._delayed)

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
