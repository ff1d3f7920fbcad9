"""The simulated chassis on its ports."""

from __future__ import annotations

import asyncio
import logging
import random
from collections import Counter
from collections.abc import Callable
from types import TracebackType

from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.frames import FrameError
from woosh_robot_agent.link.transports import Transport, TransportClosedError, WebSocketTransport
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.faults.fault import Injection
from woosh_robot_agent.simulator.faults.injector import Injector
from woosh_robot_agent.simulator.serving.client import Client
from woosh_robot_agent.simulator.serving.exchange import Exchange, Received
from woosh_robot_agent.simulator.serving.hooks import Hooks, Interceptor
from woosh_robot_agent.simulator.serving.ports import Ports
from woosh_robot_agent.simulator.snapshot import Snapshot, snapshot

_LOG = logging.getLogger(__name__)

_CLOSE_TIMEOUT = 0.3
#: Real seconds after which a socket without a single frame makes room for others.
_FIRST_FRAME_TIMEOUT = 10.0
#: Real seconds that the simulation may lag behind before it gives up catching up.
_MAX_LAG = 1.0


class SimulatedChassis:
    """A chassis on a WebSocket and a TCP port, running in the current event loop.

    Usage:
        async with SimulatedChassis(SimulatorConfig(port=0, tcp_port=0)) as simulator:
            ...  # connect to simulator.port

    All methods belong to the loop's thread; `SimulatorThread` has them for other threads.

    Attributes:
        config: The options.
        chassis: The model.
        speed: How much faster than real time simulated time runs; can be changed any time.
    """

    def __init__(self, config: SimulatorConfig | None = None) -> None:
        self.config = config or SimulatorConfig()
        self.chassis = Chassis(self.config)
        self.speed = self.config.speed
        self._exchange = Exchange(self.chassis, self.config.max_waiting)
        seed = random.randrange(2**32) if self.config.seed is None else self.config.seed
        steps = self.config.scenario.steps if self.config.scenario else ()
        self._injector = Injector(self, seed, steps)
        self._held = False
        self._hung = False
        self._crowded = False
        self._reading = asyncio.Event()
        self._writing = asyncio.Event()
        self._ports = Ports(self.config, self._serve, self._reading.wait)
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
        self._update_gates()
        self._injector.advance(0.0)
        await self.settle()
        self._ticker = asyncio.ensure_future(self._tick())

    async def stop(self) -> None:
        """Close everything, within about a second."""
        if self._ticker:
            self._ticker.cancel()
        self._injector.clear()  # readers and writers that it holds have to see the end too
        await self.settle()
        closing = [client.transport.close(_CLOSE_TIMEOUT) for client in self._exchange.clients]
        await asyncio.gather(*closing, return_exceptions=True)
        self.drop()
        await self._ports.close(reserve=False)

    async def listen(self) -> None:
        """Take clients, at the ports of the start.

        Raises:
            OSError: A port is taken.
        """
        await self._ports.listen()

    async def stop_listening(self) -> None:
        """Drop every client and take no new ones, as if switched off."""
        self.drop()
        await self._ports.close(reserve=True)

    async def settle(self) -> None:
        """Wait until the ports are as the fault `off` wants them."""
        await self._ports.settle()

    @property
    def port(self) -> int:
        """The WebSocket port, once started."""
        return self._ports.port

    @property
    def tcp_port(self) -> int:
        """The TCP port, once started."""
        return self._ports.tcp_port

    # Faults

    @property
    def hooks(self) -> Hooks:
        """Where connections, requests and frames can be caught."""
        return self._exchange.hooks

    def inject(self, name: str, /, **arguments: object) -> Injection:
        """Put a fault in; `woosh_robot_agent.simulator.faults.FAULTS` has all of them.

        The ports follow the fault `off` a little later: `settle` waits for them.

        Args:
            name: That of the fault.
            arguments: Those of the fault, `for_` among them.

        Returns:
            What ends it again, if it lasts.

        Raises:
            FaultError: There is none of this name, or an argument is wrong.
        """
        return self._injector.inject(name, **arguments)

    def clear_faults(self) -> None:
        """End all faults, and let go at once what they hold back."""
        self._injector.clear()
        for client in list(self._exchange.clients):
            client.release()

    @property
    def faults(self) -> list[Injection]:
        """The faults that last, oldest first."""
        return self._injector.active

    @property
    def injected(self) -> Counter[str]:
        """How many faults of each name there were since the start."""
        return Counter(self._injector.counts)

    # What faults do

    def drop(self) -> None:
        """End every connection at once, as a broken cable would."""
        for client in list(self._exchange.clients):
            client.drop()

    def switch(self, on: bool) -> None:
        """Drop every client and refuse new connections; or listen again at the same ports."""
        if not on:
            self.drop()
        self._ports.switch(on)

    def hold_link(self, held: bool) -> None:
        """Neither read nor write, but keep the connections; or go on."""
        self._held = held
        self._update_gates()
        for client in self._exchange.clients:
            if held:
                client.transport.pause()
            else:
                client.transport.resume()

    def hang(self, hung: bool) -> None:
        """Let model time stand still and queue what is read; or go on."""
        self._hung = hung
        self._update_gates()
        self._exchange.hang(hung)

    def set_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button."""
        self.chassis.set_emergency_stop(pressed)
        self.report()

    def set_key_switch(self, manual: bool) -> None:
        """Turn the key switch to manual, which overrules the control mode, or to automatic."""
        self.chassis.set_key_switch(manual)
        self.report()

    def lose_localisation(self) -> None:
        """Make the chassis forget where it is."""
        self.chassis.lose_localisation()
        self.report()

    def push(self, message: Message) -> None:
        """Push a message to everybody who subscribed to its type, whatever the state says."""
        self._exchange.push(message)

    def report(self) -> None:
        """Push what changed."""
        self._exchange.report_changes(while_moving=True)

    def backlog(self) -> int:
        """The most frames that wait for one client."""
        return max((client.backlog for client in self._exchange.clients), default=0)

    def room(self) -> int:
        """How many frames may wait for one client."""
        return self.config.max_outbox

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
        self._instead("refuse", type_name, text=text)

    def delay(self, type_name: str, seconds: float) -> None:
        """Hold back every answer to a type for `seconds` of real time."""
        self._instead("delay", type_name, seconds=seconds)

    def mute(self, type_name: str) -> None:
        """Do what requests of a type ask but never answer them."""
        self._instead("lose_answer", type_name)

    def answer_as(self, type_name: str, other: str) -> None:
        """Say in every answer to a type that its body is of the type `other`."""
        self._instead("wrong_type", type_name, other=other)

    def accept(self, type_name: str) -> None:
        """Treat requests of a type as usual again: end every fault that is only for them."""
        for injection in self.faults:
            if injection.arguments.get("type") == type_name:
                injection.clear()

    def intercept(self, interceptor: Interceptor) -> Callable[[], None]:
        """Let all frames through `interceptor`; the returned function takes it away again."""
        return self.hooks.intercept(interceptor)

    def send_raw(self, data: str | bytes) -> None:
        """Send a frame to every client as it is."""
        for client in list(self._exchange.clients):
            client.send(data)

    def _instead(self, name: str, type_name: str, **arguments: object) -> None:
        """Put in a fault for one type, in place of one of the same name."""
        for injection in self.faults:
            if injection.name == name and injection["type"] == type_name:
                injection.clear()
        self.inject(name, type=type_name, **arguments)

    # Clients and time

    async def _serve(self, transport: Transport) -> None:
        if self.connections >= self.config.max_connections:
            if not self._crowded:
                _LOG.warning(
                    "%s refused: %d clients already; so are further ones until one has left",
                    transport.peer,
                    self.connections,
                )
            self._crowded = True
            transport.abort()
            return
        self._crowded = False
        if not self.hooks.admits():
            _LOG.info("%s connected and is dropped by a fault", transport.peer)
            transport.abort()
            return
        client = Client(transport, self.config.max_outbox)
        self._exchange.join(client)
        writer = asyncio.ensure_future(client.write(self._writing))
        client.spoke = isinstance(transport, WebSocketTransport)  # by its handshake
        self._expect_words(client)
        _LOG.info("%s connected", transport.peer)
        if self._held:
            transport.pause()
        try:
            while True:
                await self._read(client)
                await asyncio.sleep(0)  # what one client sends in a burst must not starve the rest
        except TransportClosedError as error:
            _LOG.info("%s left: %s", transport.peer, error)
        finally:
            self._exchange.leave(client)
            writer.cancel()
            await transport.close(_CLOSE_TIMEOUT)

    def _expect_words(self, client: Client) -> None:
        """Drop a client that stays silent, which counts only while it is listened to."""

        def check() -> None:
            if client.spoke or client not in self._exchange.clients:
                return
            if self._held:
                self._expect_words(client)
                return
            _LOG.warning(
                "%s dropped: it sent no frame for %g s", client.transport.peer, _FIRST_FRAME_TIMEOUT
            )
            client.drop()

        asyncio.get_running_loop().call_later(_FIRST_FRAME_TIMEOUT, check)

    async def _read(self, client: Client) -> None:
        try:
            data = await client.transport.recv()
            client.spoke = True
        except FrameError as error:
            client.spoke = True
            self._exchange.skip(client, error)
        else:
            await self._reading.wait()
            try:
                self._exchange.receive(client, data)
            except Exception:  # an interceptor's fault, say: the others are served on
                _LOG.exception("a frame of %s failed", client.transport.peer)

    async def _tick(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            due = max(due + TIME_STEP / self.speed, loop.time() - _MAX_LAG)
            await asyncio.sleep(max(0.0, due - loop.time()))
            try:
                if not self._hung:
                    self.chassis.tick(TIME_STEP)
                self._injector.advance(TIME_STEP)
                if not self._hung:
                    self.report()
            except Exception:  # time has to go on
                _LOG.exception("a step failed")

    def _update_gates(self) -> None:
        for gate, is_open in (
            (self._reading, not self._held),
            (self._writing, not (self._held or self._hung)),
        ):
            if is_open:
                gate.set()
            else:
                gate.clear()
