"""The ports, and the connections of clients: admit clients, read requests and send frames."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket

from woosh_robot_agent.link.frames import FrameError
from woosh_robot_agent.link.server import (
    Listener,
    ServerTransport,
    serve_tcp,
    serve_websocket,
)
from woosh_robot_agent.link.transport import TransportClosedError
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.serving.exchange import Client, MessageHandler
from woosh_robot_agent.simulator.serving.http import HttpCalls, HttpTransport

_LOG = logging.getLogger(__name__)

_CLOSE_TIMEOUT = 0.3
"""Timeout for an orderly close of a connection, in seconds."""


class Connections:
    """Serves the connections of clients.

    Attributes:
        http_calls: answers HTTP requests.
    """

    def __init__(self, handler: MessageHandler, config: SimulatorConfig) -> None:
        self._handler = handler
        self._config = config
        self._paused = False
        """True if frames are neither read nor sent."""
        self._full = False
        """True if the last new client was refused because there were already too many."""
        self._reading = asyncio.Event()
        """Set while frames are read."""
        self._writing = asyncio.Event()
        """Set while frames are sent."""
        self._client_left = asyncio.Event()
        """Set when a client has disconnected; cleared by `wait_disconnected`."""
        self.http_calls = HttpCalls(handler, config, self.wait_readable, self._writing)

    @property
    def count(self) -> int:
        """Number of connected clients."""
        return len(self._handler.clients)

    @property
    def backlog(self) -> int:
        """Largest number of frames that wait for one client."""
        return max((client.backlog for client in self._handler.clients), default=0)

    def open(self) -> None:
        """Start reading and writing."""
        self._update_events()

    async def wait_disconnected(self) -> None:
        """Wait until no client is connected."""
        while self.count:
            self._client_left.clear()
            await self._client_left.wait()

    async def close(self) -> None:
        """Close all connections, and abort those that do not close within `_CLOSE_TIMEOUT`."""
        clients = self._handler.clients
        closing = [client.transport.close(_CLOSE_TIMEOUT) for client in clients]
        await asyncio.gather(*closing, return_exceptions=True)
        self.drop()

    def drop(self) -> None:
        """Abort all connections, as a broken cable would."""
        for client in list(self._handler.clients):
            client.drop()

    def set_paused(self, paused: bool) -> None:
        """Stop reading and writing without closing the connections (True), or continue (False)."""
        self._paused = paused
        self._update_events()
        for client in self._handler.clients:
            if paused:
                client.transport.pause()
            else:
                client.transport.resume()

    def set_frozen(self, frozen: bool) -> None:
        """Queue requests without executing them, and send nothing (True); or continue (False)."""
        self._handler.set_frozen(frozen)
        self._update_events()

    def send_delayed(self) -> None:
        """Send all delayed frames at once."""
        for client in list(self._handler.clients):
            client.send_delayed()

    def send_raw(self, data: str | bytes) -> None:
        """Send a frame unchanged to every client, except to those that call over HTTP."""
        for client in list(self._handler.clients):
            if not isinstance(client.transport, HttpTransport):
                client.send(data)

    async def wait_readable(self) -> None:
        """Wait while the connections are paused."""
        await self._reading.wait()

    async def serve(self, transport: ServerTransport) -> None:
        """Serve a new connection until it ends."""
        if not self._admit(transport):
            transport.abort()
            return
        client = Client(transport, self._config.max_outbox)
        self._handler.join(client)
        writer = asyncio.ensure_future(client.write(self._writing))
        _LOG.info("%s connected", transport.peer)
        if self._paused:
            transport.pause()
        try:
            while True:
                await self._read(client)
                await asyncio.sleep(0)  # a burst of one client must not starve the others
        except TransportClosedError as error:
            _LOG.info("%s disconnected: %s", transport.peer, error)
        finally:
            self._handler.leave(client)
            self._client_left.set()
            writer.cancel()
            await transport.close(_CLOSE_TIMEOUT)

    def _admit(self, transport: ServerTransport) -> bool:
        """Return True to serve a new connection; otherwise log the reason and return False."""
        if self.count >= self._config.max_connections:
            if not self._full:
                _LOG.warning(
                    "%s is refused: there are already %d clients; further ones are refused "
                    "without a warning until one disconnects",
                    transport.peer,
                    self.count,
                )
            self._full = True
            return False
        self._full = False
        if not self._handler.hooks.admit():
            _LOG.info("%s connected and is dropped by a fault", transport.peer)
            return False
        return True

    async def _read(self, client: Client) -> None:
        """Wait for the next frame of a client, and handle it."""
        try:
            data = await client.transport.recv()
        except FrameError as error:
            self._handler.skip(client, error)
        else:
            await self._reading.wait()
            try:
                self._handler.receive(client, data)
            except Exception:  # from a test's interceptor, for example
                _LOG.exception("cannot handle a frame of %s", client.transport.peer)

    def _update_events(self) -> None:
        """Set or clear `_reading` and `_writing`, as the connections are paused or frozen."""
        for event, is_set in (
            (self._reading, not self._paused),
            (self._writing, not (self._paused or self._handler.frozen)),
        ):
            if is_set:
                event.set()
            else:
                event.clear()


class Ports:
    """The WebSocket and HTTP port, and the TCP port. They can be closed, and opened again.

    Args:
        config: the address and the ports.

    Attributes:
        port: port of WebSocket and HTTP; 0 before `listen` if any free port may be used.
        tcp_port: TCP port; likewise.
    """

    def __init__(self, config: SimulatorConfig, connections: Connections) -> None:
        self.port = config.port
        self.tcp_port = config.tcp_port
        self._config = config
        self._connections = connections
        self._listeners: list[Listener] = []
        """Listeners of both ports, empty while they are closed."""
        self._reserved: list[socket.socket] = []
        """Sockets that keep the ports reserved while they are closed."""
        self._changing = asyncio.Lock()
        """Held while the ports are opened or closed."""
        self._last_change: asyncio.Task[None] | None = None
        """The last task of `set_listening`."""

    async def listen(self) -> None:
        """Start listening, unless the ports are open already.

        Raises:
            OSError: a port is in use.
        """
        async with self._changing:
            if not self._listeners:
                await self._open()

    async def close(self, *, reserve: bool) -> None:
        """Stop listening.

        Args:
            reserve: True to keep the ports reserved, so that no other program can take them.
        """
        async with self._changing:
            await self._close(reserve)

    def drop(self) -> None:
        """Abort all connections of the WebSocket port, also those between two HTTP requests."""
        for listener in self._listeners:
            listener.drop()

    def set_listening(self, on: bool) -> None:
        """Start or stop listening in the background, after earlier changes. Failures are logged."""
        previous = self._last_change

        async def change() -> None:
            if previous:
                await asyncio.wait({previous})
            try:
                await (self.listen() if on else self.close(reserve=True))
            except OSError as error:
                _LOG.error("cannot listen again on %s: %s", self._config.host, error)

        self._last_change = asyncio.ensure_future(change())

    async def settle(self) -> None:
        """Wait until the last `set_listening` has taken effect."""
        if self._last_change:
            await asyncio.wait({self._last_change})

    async def _open(self) -> None:
        """Listen on both ports, or on none.

        Raises:
            OSError: a port is in use.
        """
        config, connections = self._config, self._connections
        try:
            websocket = await serve_websocket(
                connections.serve,
                config.host,
                self.port,
                max_size=config.max_frame,
                before_handshake=connections.wait_readable,
                respond=connections.http_calls.respond,
                # Otherwise a browser on this machine would let any web page connect.
                local_pages_only=config.local,
            )
            self._listeners.append(websocket)
            tcp = await serve_tcp(
                connections.serve, config.host, self.tcp_port, max_size=config.max_frame
            )
            self._listeners.append(tcp)
        except OSError:
            await self._close(reserve=False)
            raise
        self.port, self.tcp_port = websocket.port, tcp.port
        self._free_reserved()  # not before: another program could have taken the ports

    async def _close(self, reserve: bool) -> None:
        """Stop listening, and reserve the ports or free them."""
        listeners, self._listeners = self._listeners, []
        await asyncio.gather(*(listener.close() for listener in listeners))
        if listeners or not reserve:  # otherwise the ports are reserved already
            self._free_reserved()
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

    def _free_reserved(self) -> None:
        for reserved in self._reserved:
            reserved.close()
        self._reserved.clear()
