"""The simulated chassis on its ports."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Callable
from types import TracebackType

from google.protobuf.message import Message

from woosh_robot_agent.link.frames import FrameError
from woosh_robot_agent.link.transports import (
    Listener,
    Transport,
    TransportClosedError,
    serve_tcp,
    serve_websocket,
)
from woosh_robot_agent.simulator.chassis import STEP_S, Chassis
from woosh_robot_agent.simulator.client import Client
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.exchange import Exchange, Received
from woosh_robot_agent.simulator.hooks import Interceptor
from woosh_robot_agent.simulator.snapshot import Snapshot, snapshot

_log = logging.getLogger(__name__)

_CLOSE_TIMEOUT_S = 0.3
#: Real seconds that the simulation may lag behind before it gives up catching up.
_MOST_LAG_S = 1.0


class SimulatedChassis:
    """A chassis on a WebSocket and a TCP port, running in the current event loop.

    Usage:
        async with SimulatedChassis(SimulatorConfig(port=0, tcp_port=0)) as simulator:
            ...  # connect to simulator.port

    All methods belong to the loop's thread; `SimulatorThread` has them for other threads.

    Attributes:
        config: The options.
        chassis: The model.
        port: The WebSocket port, once started.
        tcp_port: The TCP port, once started.
        speed: How much faster than real time simulated time runs; can be changed any time.
    """

    def __init__(self, config: SimulatorConfig | None = None) -> None:
        self.config = config or SimulatorConfig()
        self.chassis = Chassis(self.config)
        self.port = self.config.port
        self.tcp_port = self.config.tcp_port
        self.speed = self.config.speed
        self._exchange = Exchange(self.chassis)
        self._listeners: list[Listener] = []
        self._running = asyncio.Event()
        self._ticker: asyncio.Task[None] | None = None

    async def __aenter__(self) -> SimulatedChassis:
        await self.start()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.stop()

    async def start(self) -> None:
        """Listen, and let simulated time run.

        Raises:
            OSError: A port is taken.
        """
        await self.listen()
        self._running.set()
        self._ticker = asyncio.ensure_future(self._tick())

    async def stop(self) -> None:
        """Close everything, within about a second."""
        if self._ticker:
            self._ticker.cancel()
        closing = [client.transport.close(_CLOSE_TIMEOUT_S) for client in self._exchange.clients]
        await asyncio.gather(*closing, return_exceptions=True)
        self._running.set()  # readers that `freeze` holds have to see the end too
        await self.stop_listening()

    async def listen(self) -> None:
        """Take clients, at the ports of the start.

        Raises:
            OSError: A port is taken.
        """
        if self._listeners:
            return
        config = self.config
        for serve, port in ((serve_websocket, self.port), (serve_tcp, self.tcp_port)):
            try:
                listener = await serve(self._serve, config.host, port, max_size=config.max_frame)
            except OSError:
                await self.stop_listening()
                raise
            self._listeners.append(listener)
        self.port, self.tcp_port = (listener.port for listener in self._listeners)

    async def stop_listening(self) -> None:
        """Drop every client and take no new ones, as if switched off."""
        self.drop()
        listeners, self._listeners = self._listeners, []
        await asyncio.gather(*(listener.close() for listener in listeners))

    # What tests look at

    @property
    def connections(self) -> int:
        """How many clients are connected."""
        return len(self._exchange.clients)

    @property
    def state(self) -> Snapshot:
        """What is true of the chassis now."""
        return snapshot(self.chassis)

    @property
    def received(self) -> list[Received]:
        """What clients sent, oldest first; the last ten thousand."""
        return list(self._exchange.received)

    @property
    def counts(self) -> Counter[str]:
        """How many messages of each type clients sent, subscriptions included."""
        return Counter(self._exchange.counts)

    @property
    def bad_frames(self) -> int:
        """How many frames could not be read."""
        return self._exchange.bad_frames

    def last(self, type_name: str) -> Message | None:
        """The last message of a type that a client sent."""
        found = (each for each in reversed(self._exchange.received) if each.type == type_name)
        received = next(found, None)
        return received.message if received else None

    async def wait_received(
        self, type_name: str, count: int = 1, timeout: float = 5.0
    ) -> Message | None:
        """Wait until clients have sent `count` messages of a type since the start.

        Returns:
            The last of them.

        Raises:
            asyncio.TimeoutError: It took longer than `timeout` seconds.
        """
        await asyncio.wait_for(self._exchange.arrived(type_name, count), timeout)
        return self.last(type_name)

    # What tests do

    def refuse(self, type_name: str, text: str) -> None:
        """Refuse every request of a type with `text`, without doing it."""
        self._exchange.hooks.refuse(type_name, text)

    def delay(self, type_name: str, seconds: float) -> None:
        """Hold back every answer to a type for `seconds` of real time."""
        self._exchange.hooks.delay(type_name, seconds)

    def mute(self, type_name: str) -> None:
        """Do what requests of a type ask but never answer them."""
        self._exchange.hooks.mute(type_name)

    def answer_as(self, type_name: str, other: str) -> None:
        """Say in every answer to a type that its body is of the type `other`."""
        self._exchange.hooks.answer_as(type_name, other)

    def accept(self, type_name: str) -> None:
        """Treat requests of a type as usual again."""
        self._exchange.hooks.accept(type_name)

    def intercept(self, interceptor: Interceptor) -> Callable[[], None]:
        """Let all frames through `interceptor`; the returned function takes it away again."""
        return self._exchange.hooks.intercept(interceptor)

    def push(self, message: Message) -> None:
        """Push a message to everybody who subscribed to its type, whatever the state says."""
        self._exchange.push(message)

    def send_raw(self, data: str | bytes) -> None:
        """Send a frame to every client as it is."""
        for client in list(self._exchange.clients):
            client.send(data)

    def drop(self) -> None:
        """End every connection at once, as a broken cable would."""
        for client in list(self._exchange.clients):
            client.drop()

    def freeze(self) -> None:
        """Neither read nor write any more, but keep the connections: the link is half-open."""
        self._running.clear()
        for client in self._exchange.clients:
            client.transport.pause()

    def thaw(self) -> None:
        """Go on after `freeze`, with what has piled up."""
        self._running.set()
        for client in self._exchange.clients:
            client.transport.resume()

    def set_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button."""
        self.chassis.set_emergency_stop(pressed)
        self._exchange.report_changes(while_moving=True)

    def set_key_switch(self, manual: bool) -> None:
        """Turn the key switch to manual, which overrules the control mode, or to automatic."""
        self.chassis.set_key_switch(manual)
        self._exchange.report_changes(while_moving=True)

    def lose_localisation(self) -> None:
        """Make the chassis forget where it is."""
        self.chassis.lose_localisation()
        self._exchange.report_changes(while_moving=True)

    # Clients and time

    async def _serve(self, transport: Transport) -> None:
        if self.connections >= self.config.max_connections:
            _log.warning("%s refused: %d clients already", transport.peer, self.connections)
            transport.abort()
            return
        client = Client(transport, self.config.max_outbox)
        self._exchange.join(client)
        writer = asyncio.ensure_future(client.write(self._running))
        _log.info("%s connected", transport.peer)
        if not self._running.is_set():
            transport.pause()
        try:
            while True:
                await self._read(client)
                await asyncio.sleep(0)  # what one client sends in a burst must not starve the rest
        except TransportClosedError as error:
            _log.info("%s left: %s", transport.peer, error)
        finally:
            self._exchange.leave(client)
            writer.cancel()
            await transport.close(_CLOSE_TIMEOUT_S)

    async def _read(self, client: Client) -> None:
        try:
            data = await client.transport.recv()
        except FrameError as error:
            self._exchange.skip(client, error)
        else:
            await self._running.wait()
            try:
                self._exchange.receive(client, data)
            except Exception:  # an interceptor's fault, say: the others are served on
                _log.exception("a frame of %s failed", client.transport.peer)

    async def _tick(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            due = max(due + STEP_S / self.speed, loop.time() - _MOST_LAG_S)
            await asyncio.sleep(max(0.0, due - loop.time()))
            try:
                self.chassis.tick(STEP_S)
                self._exchange.report_changes(while_moving=True)
            except Exception:  # time has to go on
                _log.exception("a step failed")
