"""The robot with its clients, its ports and its clock, on which faults act."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket

from google.protobuf.message import Message

from woosh_robot_agent.link.frames import FrameError
from woosh_robot_agent.link.server import (
    Listener,
    ServerTransport,
    serve_tcp,
    serve_websocket,
)
from woosh_robot_agent.link.transport import TransportClosedError
from woosh_robot_agent.pb.device import device_pb2
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.serving.exchange import Client, Hooks, MessageHandler
from woosh_robot_agent.simulator.serving.http import HttpCalls, HttpTransport

_LOG = logging.getLogger(__name__)

_CLOSE_TIMEOUT = 0.3
"""Timeout for an orderly close of a connection, in seconds."""

_MIN_STEP = 0.005
"""Minimum real duration of a step, in seconds, for the simulated time to advance within the step.

Shorter steps, at a higher speed, are made as a whole.
"""

_ROUND_DURATION = 0.02
"""Real duration of a round of steps at a high speed, in seconds.

Waking up costs more than a step, so each round has several steps.
"""

_END_OF_STEP = 0.999 * TIME_STEP
"""Maximum simulated time within a step, in seconds. `Chassis.tick` completes the step."""

_MAX_LAG = 10.0
"""Maximum lag of the simulation that is caught up, in seconds of real time. The rest is skipped."""


class Server:
    """A robot on a WebSocket and a TCP port, running in the current event loop.

    Its ports can be closed, and opened again.

    Args:
        config: the options; None for the defaults.

    Attributes:
        port: port of WebSocket and HTTP. If the configured port is 0, `listen` sets the real one.
        tcp_port: TCP port; likewise.
        chassis: the model of the robot.
        speed: simulated seconds per real second, above 0. It can be changed at any time.
    """

    def __init__(self, config: SimulatorConfig | None = None) -> None:
        self.config = config or SimulatorConfig()
        self.chassis = Chassis(self.config)
        self.speed = self.config.speed
        self._handler = MessageHandler(self.chassis, self.config.max_waiting)
        self.port, self.tcp_port = self.config.port, self.config.tcp_port
        self._listeners: list[Listener] = []
        """Listeners of both ports, empty while they are closed."""
        self._reserved: list[socket.socket] = []
        """Sockets that keep the ports reserved while they are closed."""
        self._changing = asyncio.Lock()
        """Held while the ports are opened or closed. It is fair, so changes happen in order."""
        self._last_change: asyncio.Task[None] | None = None
        """The last task of `set_listening`."""
        self._paused = False
        """True if frames are neither read nor sent."""
        self._full = False
        """True if the last new client was refused because there were already too many."""
        self._reading = asyncio.Event()
        """Set while frames are read."""
        self._writing = asyncio.Event()
        """Set while frames are sent."""
        self._http_calls = HttpCalls(self._handler, self.config, self._reading, self._writing)
        self._ticker: asyncio.Task[None] | None = None
        """Task that advances the simulated time, None before the start."""
        self._step_start = 0.0
        """Time of the event loop at which the current simulation step began, in seconds."""
        self.chassis.on_schedule = self._wake_for
        self._handler.before_request = self._catch_up

    @property
    def connections(self) -> int:
        """Number of connected clients."""
        return len(self._handler.clients)

    @property
    def hooks(self) -> Hooks:
        """Hooks for connections, requests and outgoing frames."""
        return self._handler.hooks

    async def listen(self) -> None:
        """Listen on both ports, or on neither; do nothing if they are open.

        After `stop_listening`, the ports are the same as before.

        Raises:
            OSError: a port is in use.
        """
        async with self._changing:
            if self._listeners:
                return
            config = self.config
            websocket = await serve_websocket(
                self._serve,
                config.host,
                self.port,
                max_size=config.max_frame,
                before_handshake=self._reading.wait,
                respond=self._http_calls.respond,
                # Otherwise a browser on this machine would let any web page connect.
                local_pages_only=config.local,
            )
            try:
                tcp = await serve_tcp(
                    self._serve, config.host, self.tcp_port, max_size=config.max_frame
                )
            except BaseException:  # also a cancellation
                await websocket.close()
                raise
            self._listeners = [websocket, tcp]
            self.port, self.tcp_port = websocket.port, tcp.port
            self._free_reserved()  # not before: another program could have taken the ports

    async def stop_listening(self) -> None:
        """Drop all clients and refuse new ones. The simulated time goes on."""
        self.drop()
        await self._close(reserve=True)

    def set_listening(self, on: bool) -> None:
        """Listen again on the same ports (True), or drop all clients and refuse new ones (False).

        The ports change in the background. Failures are logged.
        """
        if not on:
            self.drop()

        async def change() -> None:
            try:
                await (self.listen() if on else self._close(reserve=True))
            except OSError as error:
                _LOG.error("cannot listen again on %s: %s", self.config.host, error)

        self._last_change = asyncio.ensure_future(change())

    async def settle(self) -> None:
        """Wait until all calls of `set_listening`, e.g. by the fault `off`, have taken effect."""
        if self._last_change:
            await asyncio.wait({self._last_change})

    def drop(self) -> None:
        """Abort all connections, as a broken cable would, also HTTP connections that are idle."""
        self._drop_clients()
        for listener in self._listeners:
            listener.drop()

    def pause_connections(self, paused: bool) -> None:
        """Stop reading and writing without closing the connections (True), or continue (False)."""
        self._paused = paused
        self._update_events()
        for client in self._handler.clients:
            if paused:
                client.transport.pause()
            else:
                client.transport.resume()

    def freeze(self, frozen: bool) -> None:
        """Stop the simulated time, queue all requests and send nothing (True), or continue."""
        self._handler.set_frozen(frozen)
        self._update_events()

    async def wait_disconnected(self) -> None:
        """Wait until no client is connected."""
        while self.connections:
            self._handler.client_left.clear()
            await self._handler.client_left.wait()

    def set_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button."""
        self.chassis.set_emergency_stop(pressed)
        self.push_changes()

    def set_key_switch(self, manual: bool, *, accept: bool = False) -> None:
        """Turn the key switch to manual, which overrides the control mode, or to automatic (False).

        At manual the motors are off; with `accept`, requests are accepted although nothing moves.
        """
        self.chassis.set_key_switch(manual, accept=accept)
        self.push_changes()

    def hold_remote_keys(self, keys: int, address: int = 1) -> None:
        """Hold down keys of a radio remote controller: one bit each, 0 to release all."""
        controller = device_pb2.RfRemoteController(address=address, keys=keys)
        self.chassis.remote_controller = controller
        self.push_changes()

    def lose_localisation(self) -> None:
        """Make the robot lose its localisation."""
        self.chassis.lose_localisation()
        self.push_changes()

    def push(self, message: Message) -> None:
        """Push a message to all subscribers of its type, without changing the state."""
        self._handler.push(message)

    def push_changes(self) -> None:
        """Push all events and changed states to their subscribers."""
        self._handler.report_changes(while_moving=True)

    def send_raw(self, data: str | bytes) -> None:
        """Send a frame unchanged to every client, except to those that call over HTTP."""
        for client in list(self._handler.clients):
            if not isinstance(client.transport, HttpTransport):
                client.send(data)

    @property
    def backlog(self) -> int:
        """Largest number of frames that wait for one client."""
        return max((client.backlog for client in self._handler.clients), default=0)

    async def _close(self, *, reserve: bool) -> None:
        """Stop listening, and drop the clients that are still connected or have just connected.

        Args:
            reserve: True to keep the ports reserved, so that no other program can take them.
        """
        async with self._changing:
            listeners, self._listeners = self._listeners, []
            await asyncio.gather(*(listener.close() for listener in listeners))
            self._drop_clients()
            if not reserve:
                self._free_reserved()
                return
            for listener in listeners:
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

    async def _serve(self, transport: ServerTransport) -> None:
        """Serve a new connection until it ends."""
        if not self._admit(transport):
            transport.abort()
            return
        client = Client(transport, self.config.max_outbox)
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
            writer.cancel()
            await transport.close(_CLOSE_TIMEOUT)

    def _admit(self, transport: ServerTransport) -> bool:
        """Return True to serve a new connection; otherwise log the reason and return False."""
        if self.connections >= self.config.max_connections:
            if not self._full:
                _LOG.warning(
                    "%s is refused: there are already %d clients; further ones are refused "
                    "without a warning until one disconnects",
                    transport.peer,
                    self.connections,
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

    async def _close_connections(self) -> None:
        """Close all connections, and abort those that do not close within `_CLOSE_TIMEOUT`."""
        clients = self._handler.clients
        closing = [client.transport.close(_CLOSE_TIMEOUT) for client in clients]
        await asyncio.gather(*closing, return_exceptions=True)
        self._drop_clients()

    def _drop_clients(self) -> None:
        for client in list(self._handler.clients):
            client.drop()

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

    def start_clock(self) -> None:
        """Start the simulated time, and begin to read and send frames."""
        self._update_events()
        self._step_start = asyncio.get_running_loop().time()
        self._ticker = asyncio.ensure_future(self._tick())

    def stop_clock(self) -> None:
        """Stop the simulated time."""
        if self._ticker:
            self._ticker.cancel()

    def on_step(self) -> None:
        """Called in each step, also while the robot is frozen; subclasses may override it."""

    async def _tick(self) -> None:
        """Advance the simulated time step by step, as fast as `speed` says."""
        loop = asyncio.get_running_loop()
        self._step_start = loop.time()
        while True:
            duration = TIME_STEP / self.speed
            steps = 1 if self._runs_within_steps else max(1, int(_ROUND_DURATION / duration))
            due = max(self._step_start + steps * duration, loop.time() - _MAX_LAG)
            self._wake_for(self.chassis.next_call)
            await asyncio.sleep(max(0.0, due - loop.time()))
            for _ in range(steps):
                self._step()
            self._step_start = due

    def _step(self) -> None:
        """Advance the simulated time by one step, and push what has changed.

        While the robot is frozen, only call `on_step`.
        """
        try:
            if not self._handler.frozen:
                self.chassis.tick(TIME_STEP)
            self.on_step()
            if not self._handler.frozen:
                self.push_changes()
        except Exception:  # the clock must not stop
            _LOG.exception("cannot complete a step of the simulation")

    @property
    def _runs_within_steps(self) -> bool:
        """True if the simulated time advances within a step too, not only from step to step."""
        return (
            bool(self._ticker) and not self._handler.frozen and TIME_STEP / self.speed >= _MIN_STEP
        )

    def _wake_for(self, time: float) -> None:
        """Wake up at the simulated `time` for a call of the chassis, if it is in this step."""
        into_step = time - self.chassis.stepped
        if self._runs_within_steps and into_step < TIME_STEP:
            loop = asyncio.get_running_loop()
            loop.call_at(self._step_start + into_step / self.speed, self._catch_up)

    def _catch_up(self) -> None:
        """Advance the simulated time to this moment, but not beyond the current step."""
        if not self._runs_within_steps:
            return
        into_step = (asyncio.get_running_loop().time() - self._step_start) * self.speed
        try:
            self.chassis.run_until(self.chassis.stepped + min(into_step, _END_OF_STEP))
        except Exception:  # the clock must not stop
            _LOG.exception("a scheduled call of the simulated robot failed")
        self._wake_for(self.chassis.next_call)
