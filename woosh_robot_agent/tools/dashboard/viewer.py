"""One viewer: a page that is open in a browser."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Set
from typing import Any

from aiohttp import web

from woosh_robot_agent.tools.dashboard.robot import Robot

_MAX_NOTES = 100
"""Maximum number of notes that wait; a viewer for which there are more is disconnected."""


class Viewer:
    """Sends one viewer the parts of the robot that it watches, and notes.

    A slow viewer gets fewer messages: of each part only the newest one. It delays nobody else.

    Args:
        socket: the WebSocket.
        transport: its connection.
        number: number of the viewer, from 1.

    Attributes:
        name: name of the viewer, for other viewers.
        robot: the robot that the viewer watches; None at first.
        visible: False while the page is hidden.
        commands: tasks of the commands that wait for their answer.
        heard_at: loop time of the last message from the page.
        ended_press: number of the last press of the stick that has ended; see `Control`.
    """

    def __init__(
        self, socket: web.WebSocketResponse, transport: asyncio.Transport, number: int
    ) -> None:
        self._socket = socket
        self._transport = transport
        address = transport.get_extra_info("peername")
        self.name = f"viewer {number} at {address[0]}" if address else f"viewer {number}"
        self.robot: Robot | None = None
        self.visible = True
        self.commands: set[asyncio.Task[None]] = set()
        self.ended_press = -1
        self._tells_time = False
        """True if the time is to be sent."""
        self._stale: dict[str, None] = {}
        """Names of the parts to send, in the order in which they changed."""
        self._notes: list[str] = []
        """Messages to send, none of which may be left out."""
        self._wake = asyncio.Event()
        self._closing: asyncio.Task[bool] | None = None
        """The task that closes the WebSocket, because the loop keeps only a weak reference."""
        self.heard_at = asyncio.get_running_loop().time()

    def watch(self, robot: Robot) -> None:
        """Watch a robot instead of the one before."""
        self.unwatch()
        self.robot = robot
        if self.visible:
            robot.parts.watch(self, self._changed)

    def set_visible(self, visible: bool) -> None:
        """Stop sending while the page is hidden, and go on when it is visible again."""
        self.visible = visible
        if not visible:
            self.unwatch()
        elif self.robot is not None:
            self.robot.parts.watch(self, self._changed)

    def unwatch(self) -> None:
        """Watch no robot."""
        if self.robot is not None:
            self.robot.parts.unwatch(self)
        self._stale.clear()

    def note(self, **content: Any) -> None:
        """Send a message to the page."""
        if len(self._notes) < _MAX_NOTES:
            self._notes.append(json.dumps(content, separators=(",", ":")))
            self._wake.set()
        else:
            self._transport.abort()

    def dismiss(self, code: int, reason: str) -> None:
        """Close the WebSocket; the commands that wait for their answer go on."""
        self._closing = asyncio.get_running_loop().create_task(
            self._socket.close(code=code, message=reason.encode())
        )

    async def dismissed(self) -> None:
        """Wait until `dismiss` is done, if it was called."""
        if self._closing is not None:
            await self._closing

    def tell_time(self) -> None:
        """Send the time of this process, without which the page cannot drive."""
        self._tells_time = True
        self._wake.set()

    def end_press(self, press: int, reason: str) -> None:
        """Drive no more with the current press of the stick, and tell the page why."""
        self.ended_press = max(self.ended_press, press)
        self.note(part="stick", data=reason)

    async def send(self) -> None:
        """Send what is to be sent, until the WebSocket ends or this is cancelled."""
        try:
            while True:
                await self._wake.wait()
                self._wake.clear()
                while self._notes or self._tells_time or self._stale:
                    message = self._next()
                    if isinstance(message, str):
                        await self._socket.send_str(message)
                    else:
                        await self._socket.send_bytes(message)
        except ConnectionError:
            return

    def _next(self) -> str | bytes:
        if self._notes:
            return self._notes.pop(0)
        if self._tells_time:  # after the notes: a page that knows a time after a stop knows it too
            self._tells_time = False
            return f'{{"part":"clock","data":{int(asyncio.get_running_loop().time() * 1000.0)}}}'
        name = next(iter(self._stale))
        del self._stale[name]
        assert self.robot is not None
        return self.robot.parts.messages.get(name, "{}")

    def _changed(self, names: Set[str]) -> None:
        self._stale.update(dict.fromkeys(names))
        self._wake.set()
