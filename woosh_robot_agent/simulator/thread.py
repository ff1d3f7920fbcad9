"""The simulated chassis in its own thread, for programs without asyncio."""

from __future__ import annotations

import asyncio
import concurrent.futures
import functools
import threading
from collections.abc import Callable, Coroutine
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.faults.fault import Injection
from woosh_robot_agent.simulator.server import SimulatedChassis
from woosh_robot_agent.simulator.serving.exchange import Interceptor

P = ParamSpec("P")
T = TypeVar("T")

_CALL_TIMEOUT = 60.0
"""Timeout of a call in the simulator's thread, in seconds."""


def _in_thread(
    method: Callable[Concatenate[SimulatedChassis, P], T],
) -> Callable[Concatenate[SimulatorThread, P], T]:
    """Return the method of `SimulatorThread` that calls `method` in the simulator's thread."""

    @functools.wraps(method)
    def call(thread: SimulatorThread, *args: P.args, **kwargs: P.kwargs) -> T:
        return thread.call(lambda simulator: method(simulator, *args, **kwargs))

    return call  # type: ignore[return-value] # wraps keeps the type of the wrapped function


def _awaited_in_thread(
    method: Callable[Concatenate[SimulatedChassis, P], Coroutine[Any, Any, T]],
) -> Callable[Concatenate[SimulatorThread, P], T]:
    """Return the method of `SimulatorThread` that awaits `method` in the simulator's thread."""

    @functools.wraps(method)
    def run(thread: SimulatorThread, *args: P.args, **kwargs: P.kwargs) -> T:
        return thread._await(method(thread._simulator, *args, **kwargs))

    return run  # type: ignore[return-value] # wraps keeps the type of the wrapped function


class _Property(Generic[T]):
    """A property of `SimulatorThread` that reads one of `SimulatedChassis`, in its thread.

    Args:
        getter: the property object of `SimulatedChassis`. mypy takes it for its getter.
    """

    def __init__(self, getter: Callable[[SimulatedChassis], T]) -> None:
        prop: Any = getter
        self._get: Callable[[SimulatedChassis], T] = prop.fget
        self.__doc__ = prop.__doc__

    def __get__(self, thread: SimulatorThread, owner: type[SimulatorThread]) -> T:
        return thread.call(self._get)


class ThreadInjection:
    """A fault that was injected into a `SimulatorThread`, with the attributes of an `Injection`.

    `clear` runs in the simulator's thread. Attributes are read in the calling thread.
    """

    def __init__(self, injection: Injection, thread: SimulatorThread) -> None:
        self._injection = injection
        self._thread = thread

    def __str__(self) -> str:
        return str(self._injection)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._injection, name)

    def clear(self) -> None:
        """End the fault, if it has not ended."""
        self._thread.call(lambda simulator: self._injection.clear())


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
        """Has the chassis as soon as clients can connect, or the error if the start has failed."""
        self._loop: asyncio.AbstractEventLoop
        """Event loop of the thread, set by the thread."""
        self._stopping = asyncio.Event()
        """Set in the thread to end it: an asyncio event may only be set there."""
        self._thread = threading.Thread(target=self._run, name="simulator", daemon=True)

    def __enter__(self) -> SimulatorThread:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start the thread, and return when clients can connect.

        Raises:
            DataFileError: the file of the profile or of a scene cannot be used.
            OSError: a port is in use.
            concurrent.futures.TimeoutError: the start has taken more than 60 s.
        """
        self._thread.start()
        self._ready.result(_CALL_TIMEOUT)

    def stop(self) -> None:
        """Close everything, and wait for the thread to end, for a minute at most."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stopping.set)
            self._thread.join(_CALL_TIMEOUT)

    def call(self, do: Callable[[SimulatedChassis], T]) -> T:
        """Call `do` in the simulator's thread. Return its result, or raise its exception.

        If `do` begins or ends the fault `off`, the ports are closed or open when this returns,
        except in the simulator's thread itself.

        Raises:
            concurrent.futures.TimeoutError: the call has taken more than 60 s.
        """
        simulator = self._simulator
        if threading.current_thread() is self._thread:  # e.g. in a function given to `intercept`
            return do(simulator)

        async def run() -> T:
            result = do(simulator)
            await simulator.settle()
            return result

        return self._await(run(), _CALL_TIMEOUT)

    @property
    def port(self) -> int:
        """WebSocket port."""
        return self._simulator.port

    @property
    def tcp_port(self) -> int:
        """TCP port."""
        return self._simulator.tcp_port

    connections = _Property(SimulatedChassis.connections)
    state = _Property(SimulatedChassis.state)
    received = _Property(SimulatedChassis.received)
    counts = _Property(SimulatedChassis.counts)
    bad_frames = _Property(SimulatedChassis.bad_frames)
    injected = _Property(SimulatedChassis.injected)
    last = _in_thread(SimulatedChassis.last)
    wait_received = _awaited_in_thread(SimulatedChassis.wait_received)
    refuse = _in_thread(SimulatedChassis.refuse)
    delay = _in_thread(SimulatedChassis.delay)
    mute = _in_thread(SimulatedChassis.mute)
    answer_as = _in_thread(SimulatedChassis.answer_as)
    accept = _in_thread(SimulatedChassis.accept)
    push = _in_thread(SimulatedChassis.push)
    send_raw = _in_thread(SimulatedChassis.send_raw)
    drop = _in_thread(SimulatedChassis.drop)
    clear_faults = _in_thread(SimulatedChassis.clear_faults)
    set_emergency_stop = _in_thread(SimulatedChassis.set_emergency_stop)
    set_key_switch = _in_thread(SimulatedChassis.set_key_switch)
    hold_remote_keys = _in_thread(SimulatedChassis.hold_remote_keys)
    lose_localisation = _in_thread(SimulatedChassis.lose_localisation)
    listen = _awaited_in_thread(SimulatedChassis.listen)
    stop_listening = _awaited_in_thread(SimulatedChassis.stop_listening)

    def intercept(self, interceptor: Interceptor) -> Callable[[], None]:
        """Pass all outgoing frames through `interceptor`, which runs in the simulator's thread.

        Returns:
            A function that removes the interceptor.
        """
        remove = self.call(lambda simulator: simulator.intercept(interceptor))
        return lambda: self.call(lambda simulator: remove())

    def inject(self, name: str, /, **arguments: object) -> ThreadInjection:
        """Start a fault; see `SimulatedChassis.inject`."""
        injection = self.call(lambda simulator: simulator.inject(name, **arguments))
        return ThreadInjection(injection, self)

    @property
    def faults(self) -> list[ThreadInjection]:
        """Active faults, oldest first."""
        faults = self.call(lambda simulator: simulator.faults)
        return [ThreadInjection(each, self) for each in faults]

    @property
    def _simulator(self) -> SimulatedChassis:
        return self._ready.result(_CALL_TIMEOUT)

    def _await(self, coroutine: Coroutine[Any, Any, T], timeout: float | None = None) -> T:
        if threading.current_thread() is self._thread:
            coroutine.close()
            raise RuntimeError("this would wait for its own thread: call it in another one")
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(timeout)

    def _run(self) -> None:
        """Run the event loop. An error before clients can connect is handed over to `start`."""
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            if self._ready.done():
                raise
            self._ready.set_exception(error)

    async def _serve(self) -> None:
        """Run the chassis until `stop`, and hand it over once clients can connect."""
        self._loop = asyncio.get_running_loop()
        async with SimulatedChassis(self._config) as simulator:
            self._ready.set_result(simulator)
            await self._stopping.wait()
