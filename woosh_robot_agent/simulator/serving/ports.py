"""The ports on which clients connect. They can be closed and opened again."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Awaitable, Callable

from woosh_robot_agent.link.server import Handler, Listener, serve_tcp, serve_websocket
from woosh_robot_agent.simulator.config import SimulatorConfig

_LOG = logging.getLogger(__name__)


class Ports:
    """A WebSocket and a TCP port that can be closed and opened again with the same numbers.

    Args:
        config: The address and the ports.
        serve: Serves one connection.
        before: Awaited before the handshake of a WebSocket is answered.

    Attributes:
        port: WebSocket port, valid once it listens.
        tcp_port: TCP port, valid once it listens.
    """

    def __init__(
        self, config: SimulatorConfig, serve: Handler, before: Callable[[], Awaitable[object]]
    ) -> None:
        self.port = config.port
        self.tcp_port = config.tcp_port
        self._config = config
        self._serve = serve
        self._before = before
        self._listeners: list[Listener] = []
        """Listeners of both ports, empty while they are closed."""
        self._reserved: list[socket.socket] = []
        """Sockets that keep the ports reserved while they are closed."""
        self._changing = asyncio.Lock()
        """Held while the ports are opened or closed."""
        self._switching: asyncio.Task[None] | None = None
        """The last task of `switch`."""

    async def listen(self) -> None:
        """Start listening.

        Raises:
            OSError: A port is in use.
        """
        async with self._changing:
            if not self._listeners:
                await self._open()

    async def close(self, *, reserve: bool) -> None:
        """Stop listening.

        Args:
            reserve: Keep the ports reserved, so that no other program can take them.
        """
        async with self._changing:
            await self._close(reserve)

    def switch(self, on: bool) -> None:
        """Start or stop listening in the background. Failures are logged."""
        before = self._switching

        async def change() -> None:
            if before:
                await asyncio.wait({before})
            try:
                await (self.listen() if on else self.close(reserve=True))
            except OSError as error:
                _LOG.error("cannot listen again on %s: %s", self._config.host, error)

        self._switching = asyncio.ensure_future(change())

    async def settle(self) -> None:
        """Wait until `switch` has finished."""
        if self._switching:
            await asyncio.wait({self._switching})

    async def _open(self) -> None:
        config = self._config
        try:
            websocket = await serve_websocket(
                self._serve,
                config.host,
                self.port,
                max_size=config.max_frame,
                before=self._before,
                # Otherwise any web page in a browser on this machine could connect.
                local_pages_only=config.local,
            )
            self._listeners.append(websocket)
            tcp = await serve_tcp(
                self._serve, config.host, self.tcp_port, max_size=config.max_frame
            )
            self._listeners.append(tcp)
        except OSError:
            await self._close(reserve=False)
            raise
        self.port, self.tcp_port = websocket.port, tcp.port
        self._free()

    async def _close(self, reserve: bool) -> None:
        listeners, self._listeners = self._listeners, []
        await asyncio.gather(*(listener.close() for listener in listeners))
        self._free()
        for listener in listeners if reserve else ():
            for family, address in listener.addresses:
                self._reserve(family, address)

    def _reserve(self, family: int, address: tuple[str, int]) -> None:
        """Bind a port without listening, so that connections to it are refused.

        Otherwise the kernel might assign it to another program, or to the local end of a client's
        connection.
        """
        reserved = socket.socket(family)
        self._reserved.append(reserved)
        reserved.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            reserved.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        with contextlib.suppress(OSError):  # already taken: listening again will report it
            reserved.bind(address)

    def _free(self) -> None:
        for reserved in self._reserved:
            reserved.close()
        self._reserved.clear()
