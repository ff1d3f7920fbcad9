"""The ports at which a simulated chassis takes clients, while it is switched on."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Awaitable, Callable

from woosh_robot_agent.link.transports import Handler, Listener, serve_tcp, serve_websocket
from woosh_robot_agent.simulator.config import SimulatorConfig

_LOG = logging.getLogger(__name__)


class Ports:
    """A WebSocket and a TCP port that can be closed and come back with the same numbers.

    Args:
        config: Says where to listen.
        serve: Serves one connection.
        before: Is waited for before a WebSocket's handshake is answered.

    Attributes:
        port: The WebSocket port, once listening.
        tcp_port: The TCP port, once listening.
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
        self._reserved: list[socket.socket] = []
        self._changing = asyncio.Lock()
        self._switching: asyncio.Task[None] | None = None

    async def listen(self) -> None:
        """Take clients.

        Raises:
            OSError: A port is taken.
        """
        async with self._changing:
            if not self._listeners:
                await self._open()

    async def close(self, *, reserve: bool) -> None:
        """Take no clients.

        Args:
            reserve: Keep others from taking the ports meanwhile.
        """
        async with self._changing:
            await self._close(reserve)

    def switch(self, on: bool) -> None:
        """Begin to take clients or to take none; what fails is logged."""
        before = self._switching

        async def change() -> None:
            if before:
                await asyncio.wait({before})
            try:
                await (self.listen() if on else self.close(reserve=True))
            except OSError as error:
                _LOG.error("cannot listen again: %s", error)

        self._switching = asyncio.ensure_future(change())

    async def settle(self) -> None:
        """Wait until what `switch` began is done."""
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
                # any page in this machine's browser could connect; beyond it there is no telling
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
        """Hold a port without listening: connections to it are refused, as they have to be.

        Else the kernel might give it away, even to a client as the near end of its connection.
        """
        place = socket.socket(family)
        self._reserved.append(place)
        place.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            place.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        with contextlib.suppress(OSError):  # already gone: to listen again says so
            place.bind(address)

    def _free(self) -> None:
        for place in self._reserved:
            place.close()
        self._reserved.clear()
