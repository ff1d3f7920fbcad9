"""One viewer: a page that is open in a browser."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import Collection
from functools import partial
from typing import Any

from aiohttp import web

from woosh_robot_agent.link.tasks import abort_transport
from woosh_robot_agent.sentences import Said
from woosh_robot_agent.tools.dashboard.parts import Parts
from woosh_robot_agent.tools.dashboard.robot import Robot
from woosh_robot_agent.tools.dashboard.texts import value_data

_MAX_NOTES = 100
"""Maximum number of waiting notes and parts. One more note disconnects the viewer."""
_PIECE = 16_000
"""Maximum length of a message, in characters. A longer part or note is sent in pieces."""


class Viewer:
    """Sends one viewer the parts of the robot that it watches, and notes.

    A note is a message that must not be left out, e.g. the reply to a command. A slow viewer gets
    fewer messages: of each part only the newest one. It delays no other viewer. Between the pieces
    of a large part or note, e.g. the map, it gets other messages. A large part that changes
    meanwhile is sent to its end first, because it may change faster than it can be sent.

    Args:
        is_writable: set while the connection takes more messages.
        number: number of the viewer, from 1.
        shared: parts about all robots together, which every viewer watches.

    Attributes:
        name: name of the viewer, for other viewers: its number and its address.
        may_control: True if the viewer may command robots.
        robot: the robot that the viewer watches, from the first call of `watch` on.
        visible: False while the page is hidden.
        commands: asyncio tasks of the commands in flight; maintained by the server.
        heard_at: loop time of the last message from the page, or of its connection; updated by the
            server.
        press: number of the last press of the stick; -1 before the first.
        press_clock: newest time of this process that the page knew when this press began, in
            milliseconds.
        ended_press: number of the last press of the stick that has ended, -1 before; see `Control`.
    """

    def __init__(
        self,
        socket: web.WebSocketResponse,
        transport: asyncio.Transport,
        is_writable: asyncio.Event,
        number: int,
        shared: Parts,
        robot: Robot,
        *,
        may_control: bool,
    ) -> None:
        self._socket = socket
        self._transport = transport
        self._is_writable = is_writable
        self._shared = shared
        address = transport.get_extra_info("peername")
        self.name = f"{number} ({address[0]})" if address else str(number)
        self.may_control = may_control
        self.robot = robot
        self.visible = True
        self.commands: set[asyncio.Task[None]] = set()
        self.press = -1
        self.press_clock = 0.0
        self.ended_press = -1
        self._is_time_due = False
        """True if the time has to be sent."""
        self._stale: dict[tuple[Parts, str], None] = {}
        """The parts and large notes to send, as `Parts` object and name, as an ordered set."""
        self._begun: dict[tuple[Parts, str], tuple[str, int]] = {}
        """Messages of which only pieces have been sent, and the number of characters sent.

        The keys are those of `_stale`.
        """
        self._notes: list[str] = []
        """Notes to send, without the large ones, which are in `_stale`."""
        self._large_notes = itertools.count()
        """Numbers of the large notes."""
        self._wake = asyncio.Event()
        self._closing: asyncio.Task[bool] | None = None
        """The task that closes the WebSocket; kept, because the loop has only a weak reference."""
        self.heard_at = asyncio.get_running_loop().time()

    def watch(self, robot: Robot) -> None:
        """Watch a robot instead of the current robot."""
        self.unwatch()
        self.robot = robot
        self._watch()

    def set_visible(self, visible: bool) -> None:
        """Begin or stop sending parts: a hidden page needs none."""
        self.visible = visible
        self.unwatch()
        self._watch()

    def unwatch(self) -> None:
        """Send no more parts."""
        for parts in (self._shared, self.robot.parts):
            parts.unwatch(self)
            for waiting in (self._stale, self._begun):
                for part in [each for each in waiting if each[0] is parts]:
                    waiting.pop(part)

    def _watch(self) -> None:
        if self.visible:
            for parts in (self._shared, self.robot.parts):
                parts.watch(self, partial(self._changed, parts))

    def note(self, **content: Any) -> None:
        """Send a note to the page; disconnect the viewer if too many messages wait."""
        message = json.dumps(content, separators=(",", ":"))
        if len(self._notes) + len(self._stale) >= _MAX_NOTES:
            abort_transport(self._transport)
        elif len(message) > _PIECE:  # in pieces, like a part, so that others overtake it
            large = Parts()
            large.messages[name := f"note {next(self._large_notes)}"] = message
            self._changed(large, [name])
        else:
            self._notes.append(message)
            self._wake.set()

    def dismiss(self, code: int, reason: str) -> None:
        """Close the WebSocket; the commands that wait for their answer go on."""
        self._closing = asyncio.get_running_loop().create_task(
            self._socket.close(code=code, message=reason.encode())
        )

    async def wait_dismissed(self) -> None:
        """Wait until `dismiss` is done, if it was called."""
        if self._closing is not None:
            await self._closing

    def tell_time(self) -> None:
        """Send the time of this process, without which the page cannot drive."""
        self._is_time_due = True
        self._wake.set()

    def end_press(self, press: int, reason: Said) -> None:
        """End a press of the stick, and tell the page why."""
        self.ended_press = max(self.ended_press, press)
        self.note(part="stick", data=value_data(reason))

    async def send(self) -> None:
        """Send notes, the time and changed parts, until the WebSocket ends or this is cancelled."""
        try:
            while True:
                await self._wake.wait()
                await self._is_writable.wait()
                if not (self._notes or self._is_time_due or self._stale):
                    self._wake.clear()
                    continue
                message = self._next()
                if isinstance(message, str):
                    await self._socket.send_str(message)
                else:
                    await self._socket.send_bytes(message)
        except ConnectionError:
            return

    def _next(self) -> str | bytes:
        """Return the next message: a note, else the time, else a part.

        Call it only if at least one of them is to be sent.
        """
        if self._notes:
            return self._notes.pop(0)
        # after the notes: a page that knows a time after a stop has also got the note of the stop
        if self._is_time_due:
            self._is_time_due = False
            return f'{{"part":"clock","data":{int(asyncio.get_running_loop().time() * 1000.0)}}}'
        parts, name = part = next(iter(self._stale))
        del self._stale[part]
        newest = parts.messages[name]
        message, begin = self._begun.pop(part, (newest, 0))
        if isinstance(message, bytes) or len(message) <= _PIECE:
            return message
        end = begin + _PIECE
        if end < len(message):
            self._begun[part] = message, end
        if end < len(message) or message is not newest:  # more pieces follow, or a newer message
            self._stale[part] = None
        head = {"part": name, "begin": begin, "last": end >= len(message)}
        return f"{json.dumps(head)}\n{message[begin:end]}"

    def _changed(self, parts: Parts, names: Collection[str]) -> None:
        self._stale.update(dict.fromkeys((parts, name) for name in names))
        self._wake.set()
