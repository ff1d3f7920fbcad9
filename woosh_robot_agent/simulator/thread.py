"""The simulated chassis in its own thread, for programs without asyncio."""

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
from woosh_robot_agent.simulator.server import SimulatedChassis, Snapshot
from woosh_robot_agent.simulator.serving.exchange import Interceptor, Received

T = TypeVar("T")

_CALL_TIMEOUT = 10.0


class ThreadInjection:
    """A fault that was injected into a `SimulatorThread`."""

    def __init__(
        self, injection: Injection, change: Callable[[Callable[[SimulatedChassis], Any]], Any]
    ) -> None:
        self._injection = injection
        self._change = change

    def __str__(self) -> str:
        """Return the fault as on the command line, without arguments at their defaults."""
        return str(self._injection)

    @property
    def name(self) -> str:
        """Name of the fault."""
        return self._injection.name

    @property
    def arguments(self) -> dict[str, Any]:
        """All arguments, defaults included, by name."""
        return self._injection.arguments

    @property
    def hits(self) -> int:
        """Number of answers, frames or connections that the fault has affected."""
        return self._injection.hits

    @property
    def active(self) -> bool:
        """True until the fault ends."""
        return self._injection.active

    def clear(self) -> None:
        """End the fault, if it has not ended."""
        self._change(lambda simulator: self._injection.clear())


class SimulatorThread:
    """A simulated chassis in its own thread. Its methods can be called from any thread.

    Usage:
        with SimulatorThread(SimulatorConfig(port=0, tcp_port=0, speed=20)) as simulator:
            ...  # connect to simulator.port

    Use `call` for anything that has no method here.
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
        """Start the thread, and return when clients can connect.

        Raises:
            OSError: A port is in use.
        """
        self._thread.start()
        self._ready.result(_CALL_TIMEOUT)

    def stop(self) -> None:
        """Close everything, and wait for the thread to end."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stopping.set)
            self._thread.join(_CALL_TIMEOUT)

    def call(self, do: Callable[[SimulatedChassis], T]) -> T:
        """Call `do` in the simulator's thread and return its result."""
        simulator = self._simulator

        async def run() -> T:
            return do(simulator)

        return self._await(run())

    @property
    def port(self) -> int:
        """WebSocket port."""
        return self._simulator.port

    @property
    def tcp_port(self) -> int:
        """TCP port."""
        return self._simulator.tcp_port

    @property
    def connections(self) -> int:
        """Number of connected clients."""
        return self.call(lambda simulator: simulator.connections)

    @property
    def state(self) -> Snapshot:
        """Current state of the robot."""
        return self.call(lambda simulator: simulator.state)

    @property
    def received(self) -> list[Received]:
        """The last 10,000 messages from clients, oldest first."""
        return self.call(lambda simulator: simulator.received)

    @property
    def counts(self) -> Counter[str]:
        """Number of messages from clients, subscriptions included, by type."""
        return self.call(lambda simulator: simulator.counts)

    @property
    def bad_frames(self) -> int:
        """Number of frames that could not be decoded."""
        return self.call(lambda simulator: simulator.bad_frames)

    def last(self, type_name: str) -> Message | None:
        """Return the last message of a type from a client, None if there is none."""
        return self.call(lambda simulator: simulator.last(type_name))

    def wait_received(
        self, type_name: str, count: int = 1, timeout: float = 60.0
    ) -> Message | None:
        """Wait until clients have sent `count` messages of a type since the start of the run.

        Returns:
            The last of them.

        Raises:
            asyncio.TimeoutError: It took longer than `timeout` seconds.
        """
        return self._await(self._simulator.wait_received(type_name, count, timeout), timeout)

    def refuse(self, type_name: str, text: str) -> None:
        """Refuse all requests of a type with `text`, without executing them."""
        self.call(lambda simulator: simulator.refuse(type_name, text))

    def delay(self, type_name: str, seconds: float) -> None:
        """Delay all answers to requests of a type by `seconds` of real time."""
        self.call(lambda simulator: simulator.delay(type_name, seconds))

    def mute(self, type_name: str) -> None:
        """Execute requests of a type without answering them."""
        self.call(lambda simulator: simulator.mute(type_name))

    def answer_as(self, type_name: str, other: str) -> None:
        """Give all answers to requests of a type the wrong type `other`."""
        self.call(lambda simulator: simulator.answer_as(type_name, other))

    def accept(self, type_name: str) -> None:
        """End all faults that apply only to requests of a type."""
        self.call(lambda simulator: simulator.accept(type_name))

    def intercept(self, interceptor: Interceptor) -> Callable[[], None]:
        """Pass all outgoing frames through `interceptor`, which runs in the simulator's thread.

        Returns:
            A function that removes the interceptor.
        """
        remove = self.call(lambda simulator: simulator.intercept(interceptor))
        return lambda: self.call(lambda simulator: remove())

    def push(self, message: Message) -> None:
        """Push a message to all subscribers of its type, without changing the state."""
        self.call(lambda simulator: simulator.push(message))

    def send_raw(self, data: str | bytes) -> None:
        """Send a frame to every client unchanged."""
        self.call(lambda simulator: simulator.send_raw(data))

    def drop(self) -> None:
        """Abort all connections, as a broken cable would."""
        self.call(lambda simulator: simulator.drop())

    def inject(self, name: str, /, **arguments: object) -> ThreadInjection:
        """Start a fault. `woosh_robot_agent.simulator.faults.FAULTS` lists them all.

        Args:
            name: Name of the fault.
            arguments: Arguments of the fault, and `for_`.

        Returns:
            The injected fault, which can be cleared.

        Raises:
            FaultError: There is no such fault, or an argument is invalid.
        """
        injection = self._change(lambda simulator: simulator.inject(name, **arguments))
        return ThreadInjection(injection, self._change)

    def clear_faults(self) -> None:
        """End all faults, and send at once all frames that they delay."""
        self._change(lambda simulator: simulator.clear_faults())

    @property
    def faults(self) -> list[ThreadInjection]:
        """Active faults, oldest first."""
        return [
            ThreadInjection(injection, self._change)
            for injection in self.call(lambda simulator: simulator.faults)
        ]

    @property
    def injected(self) -> Counter[str]:
        """Number of faults since the start, by name."""
        return self.call(lambda simulator: simulator.injected)

    def set_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button."""
        self.call(lambda simulator: simulator.set_emergency_stop(pressed))

    def set_key_switch(self, manual: bool, *, accept: bool = False) -> None:
        """Turn the key switch to manual, or to automatic.

        At manual it overrides the control mode and switches the motors off.

        Args:
            manual: True for manual, False for automatic.
            accept: At manual, accept requests instead of refusing them. The motors stay off.
        """
        self.call(lambda simulator: simulator.set_key_switch(manual, accept=accept))

    def hold_remote_keys(self, keys: int, address: int = 1) -> None:
        """Hold down keys of a radio remote controller, until the next call.

        Args:
            keys: One bit for each key; 0 releases all keys.
            address: Address of the controller.
        """
        self.call(lambda simulator: simulator.hold_remote_keys(keys, address))

    def lose_localisation(self) -> None:
        """Make the robot lose its localisation."""
        self.call(lambda simulator: simulator.lose_localisation())

    def listen(self) -> None:
        """Start listening again on the same ports."""
        self._await(self._simulator.listen())

    def stop_listening(self) -> None:
        """Drop all clients and refuse new ones, as if the robot were switched off."""
        self._await(self._simulator.stop_listening())

    def _change(self, do: Callable[[SimulatedChassis], T]) -> T:
        """Run `do` in the simulator's thread, and wait until the ports are open or closed."""
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
