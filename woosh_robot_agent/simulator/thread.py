"""The simulated chassis in a thread of its own, for programs that are not asyncio's."""

from __future__ import annotations

import asyncio
import concurrent.futures
import threading
from collections import Counter
from collections.abc import Callable, Coroutine
from types import TracebackType
from typing import Any, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.faults.fault import Injection
from woosh_robot_agent.simulator.server import SimulatedChassis
from woosh_robot_agent.simulator.serving.exchange import Received
from woosh_robot_agent.simulator.serving.hooks import Interceptor
from woosh_robot_agent.simulator.snapshot import Snapshot

T = TypeVar("T")

_CALL_TIMEOUT = 10.0


class ThreadInjection:
    """A fault that was put into a `SimulatorThread`; see `Injection`."""

    def __init__(
        self, injection: Injection, change: Callable[[Callable[[SimulatedChassis], Any]], Any]
    ) -> None:
        self._injection = injection
        self._change = change

    def __str__(self) -> str:
        """As on the command line, without what is at its default."""
        return str(self._injection)

    @property
    def name(self) -> str:
        """The name of its kind."""
        return self._injection.name

    @property
    def arguments(self) -> dict[str, Any]:
        """All of them, defaults included, by name."""
        return self._injection.arguments

    @property
    def hits(self) -> int:
        """How many answers, frames or connections it has met."""
        return self._injection.hits

    @property
    def active(self) -> bool:
        """Whether it still lasts."""
        return self._injection.active

    def clear(self) -> None:
        """End it; nothing happens if it is over."""
        self._change(lambda simulator: self._injection.clear())


class SimulatorThread:
    """A simulated chassis that runs beside the caller; its methods can be called from any thread.

    Usage:
        with SimulatorThread(SimulatorConfig(port=0, tcp_port=0, speed=20)) as simulator:
            ...  # connect to simulator.port

    What is not here can be done with `call`.
    """

    def __init__(self, config: SimulatorConfig | None = None) -> None:
        self._config = config
        self._ready: concurrent.futures.Future[SimulatedChassis] = concurrent.futures.Future()
        self._loop: asyncio.AbstractEventLoop
        self._stopping = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="simulator", daemon=True)

    def __enter__(self) -> SimulatorThread:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stop()

    def start(self) -> None:
        """Start, and return when clients can connect.

        Raises:
            OSError: A port is taken.
        """
        self._thread.start()
        self._ready.result(_CALL_TIMEOUT)

    def stop(self) -> None:
        """Close everything, and return when that is done."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stopping.set)
            self._thread.join(_CALL_TIMEOUT)

    def call(self, do: Callable[[SimulatedChassis], T]) -> T:
        """Run `do` in the simulator's thread and return what it returns."""
        simulator = self._simulator

        async def run() -> T:
            return do(simulator)

        return self._await(run())

    @property
    def port(self) -> int:
        """The WebSocket port."""
        return self._simulator.port

    @property
    def tcp_port(self) -> int:
        """The TCP port."""
        return self._simulator.tcp_port

    @property
    def connections(self) -> int:
        """How many clients are connected."""
        return self.call(lambda simulator: simulator.connections)

    @property
    def state(self) -> Snapshot:
        """What is true of the chassis now."""
        return self.call(lambda simulator: simulator.state)

    @property
    def received(self) -> list[Received]:
        """What clients sent, oldest first; the last ten thousand."""
        return self.call(lambda simulator: simulator.received)

    @property
    def counts(self) -> Counter[str]:
        """How many messages of each type clients sent, subscriptions included."""
        return self.call(lambda simulator: simulator.counts)

    @property
    def bad_frames(self) -> int:
        """How many frames could not be read."""
        return self.call(lambda simulator: simulator.bad_frames)

    def last(self, type_name: str) -> Message | None:
        """The last message of a type that a client sent."""
        return self.call(lambda simulator: simulator.last(type_name))

    def wait_received(self, type_name: str, count: int = 1, timeout: float = 5.0) -> Message | None:
        """Wait until clients have sent `count` messages of a type since the start.

        Returns:
            The last of them.

        Raises:
            asyncio.TimeoutError: It took longer than `timeout` seconds.
        """
        return self._await(self._simulator.wait_received(type_name, count, timeout), timeout)

    def refuse(self, type_name: str, text: str) -> None:
        """Refuse every request of a type with `text`, without doing it."""
        self.call(lambda simulator: simulator.refuse(type_name, text))

    def delay(self, type_name: str, seconds: float) -> None:
        """Hold back every answer to a type for `seconds` of real time."""
        self.call(lambda simulator: simulator.delay(type_name, seconds))

    def mute(self, type_name: str) -> None:
        """Do what requests of a type ask but never answer them."""
        self.call(lambda simulator: simulator.mute(type_name))

    def answer_as(self, type_name: str, other: str) -> None:
        """Say in every answer to a type that its body is of the type `other`."""
        self.call(lambda simulator: simulator.answer_as(type_name, other))

    def accept(self, type_name: str) -> None:
        """Treat requests of a type as usual again."""
        self.call(lambda simulator: simulator.accept(type_name))

    def intercept(self, interceptor: Interceptor) -> Callable[[], None]:
        """Let all frames through `interceptor`, which runs in the simulator's thread.

        Returns:
            What takes it away again.
        """
        remove = self.call(lambda simulator: simulator.intercept(interceptor))
        return lambda: self.call(lambda simulator: remove())

    def push(self, message: Message) -> None:
        """Push a message to everybody who subscribed to its type, whatever the state says."""
        self.call(lambda simulator: simulator.push(message))

    def send_raw(self, data: str | bytes) -> None:
        """Send a frame to every client as it is."""
        self.call(lambda simulator: simulator.send_raw(data))

    def drop(self) -> None:
        """End every connection at once, as a broken cable would."""
        self.call(lambda simulator: simulator.drop())

    def inject(self, name: str, /, **arguments: object) -> ThreadInjection:
        """Put a fault in; `woosh_robot_agent.simulator.faults.FAULTS` has all of them.

        Args:
            name: That of the fault.
            arguments: Those of the fault, `for_` among them.

        Returns:
            What ends it again, if it lasts.

        Raises:
            FaultError: There is none of this name, or an argument is wrong.
        """
        injection = self._change(lambda simulator: simulator.inject(name, **arguments))
        return ThreadInjection(injection, self._change)

    def clear_faults(self) -> None:
        """End all faults, and let go at once what they hold back."""
        self._change(lambda simulator: simulator.clear_faults())

    @property
    def faults(self) -> list[ThreadInjection]:
        """The faults that last, oldest first."""
        return [
            ThreadInjection(injection, self._change)
            for injection in self.call(lambda simulator: simulator.faults)
        ]

    @property
    def injected(self) -> Counter[str]:
        """How many faults of each name there were since the start."""
        return self.call(lambda simulator: simulator.injected)

    def set_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button."""
        self.call(lambda simulator: simulator.set_emergency_stop(pressed))

    def set_key_switch(self, manual: bool) -> None:
        """Turn the key switch to manual, which overrules the control mode, or to automatic."""
        self.call(lambda simulator: simulator.set_key_switch(manual))

    def lose_localisation(self) -> None:
        """Make the chassis forget where it is."""
        self.call(lambda simulator: simulator.lose_localisation())

    def listen(self) -> None:
        """Take clients, at the ports of the start."""
        self._await(self._simulator.listen())

    def stop_listening(self) -> None:
        """Drop every client and take no new ones, as if switched off."""
        self._await(self._simulator.stop_listening())

    def _change(self, do: Callable[[SimulatedChassis], T]) -> T:
        """Run `do` in the simulator's thread, and return when the ports follow it."""
        simulator = self._simulator

        async def run() -> T:
            result = do(simulator)
            await simulator.settle()
            return result

        return self._await(run())

    @property
    def _simulator(self) -> SimulatedChassis:
        return self._ready.result(_CALL_TIMEOUT)

    def _await(self, coroutine: Coroutine[Any, Any, T], extra: float = 0.0) -> T:
        future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        return future.result(_CALL_TIMEOUT + extra)

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            if self._ready.done():
                raise
            self._ready.set_exception(error)

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        async with SimulatedChassis(self._config) as simulator:
            self._ready.set_result(simulator)
            await self._stopping.wait()
