"""Service calls through the agent and through the floors."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.qos import QoSProfile

from benchmarks.figures import MICROSECONDS, Measured, Spread, Target, no_garbage_collection
from benchmarks.measurements.bare_client import BareClient
from benchmarks.options import Options
from benchmarks.processes import Program, running, running_agent, running_chassis
from woosh_robot_agent.testing import own_domain, wait_until
from woosh_robot_agent.testing.agents import NAMESPACE
from woosh_robot_msgs.srv import PoseSpeed, ScannerData

FIGURES = {
    "service_rtt": Target(2.0, 1.5, "median of a service call / (bare service + bare WebSocket)"),
    "service_rtt_p99": Target(3.0, 2.0, "the same at p99"),
    "service_cpu": Target(2.0, 1.3, "agent's CPU per call / (bare server + bare client)"),
    "concurrent": Target(0.93, 0.96, "10 concurrent calls of 50 ms: throughput / ideal", True),
}
Service = tuple[Any, str]
"""ROS type and name of a service."""
POSE_SPEED: Service = (PoseSpeed, "robot/PoseSpeed")
SCAN: Service = (ScannerData, "robot/ScannerData")
_DELAY = 0.05
"""Delay of the chassis's answer to each concurrent call, in seconds."""
_CONCURRENT = 10
"""Number of concurrent calls."""
_IDEAL = _CONCURRENT / _DELAY
"""Ideal throughput of concurrent calls, in calls per second."""
_CALL_TIMEOUT = 30.0
"""Timeout for the answer to a call, in seconds."""


class Caller(BareClient):
    """Calls a service."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain)
        self._make_request: Callable[[], Any]
        self._client: Any = None

    def use(self, srv: Any, name: str, request: Any = None, *, first_timeout: float = 0.2) -> None:
        """Select the service to call, and wait until it answers.

        Args:
            srv: ROS type of the service.
            name: name of the service.
            request: request of all calls; None sends a new empty one with each call.
            first_timeout: time after which a call without an answer is made again, in seconds.
        """
        if self._client is not None:
            self.node.destroy_client(self._client)
        self._make_request = srv.Request if request is None else lambda: request
        self._client = self.node.create_client(
            srv, f"{NAMESPACE}/{name}", qos_profile=QoSProfile(depth=1000)
        )
        wait_until(self._client.service_is_ready, "the service", _CALL_TIMEOUT)
        # a service that is ready may not have discovered this client yet
        wait_until(lambda: self._call(first_timeout), "the first answer", _CALL_TIMEOUT)

    def warm_up(self, seconds: float) -> None:
        """Call for a while without recording, until discovery is over and caches are warm."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.calls(5)

    def calls(self, count: int) -> list[float]:
        """Make calls one after the other; return their round-trip times, in seconds."""
        times = []
        for _ in range(count):
            begin = time.perf_counter()
            if not self._call(_CALL_TIMEOUT):
                raise AssertionError("a call was not answered")
            times.append(time.perf_counter() - begin)
        return times

    def _call(self, timeout: float) -> bool:
        """Call once; return True if the answer came in time."""
        future = self._client.call_async(self._make_request())
        return self.spin_until(future.done, timeout)

    def concurrent_calls(self, count: int, in_flight: int) -> float:
        """Keep `in_flight` calls in flight; return the time that all calls took, in seconds."""
        begin = time.perf_counter()
        load = self.start_load(in_flight, count)
        if not self.spin_until(lambda: load.done >= count, 2 * _CALL_TIMEOUT):
            raise AssertionError(f"only {load.done} of {count} calls were answered")
        return time.perf_counter() - begin

    def start_load(self, in_flight: int, count: float = math.inf) -> Load:
        """Keep `in_flight` calls of the selected service in flight while this node spins."""
        return Load(partial(self._client.call_async, self._make_request()), in_flight, count)


class Load:
    """Calls of a service that are in flight all the time.

    Args:
        call: makes a call; returns its future.
        in_flight: number of calls in flight.
        count: number of calls.

    Attributes:
        done: number of answered calls.
    """

    def __init__(self, call: Callable[[], Any], in_flight: int, count: float) -> None:
        self._call = call
        self._left = count
        self.done = 0
        for _ in range(in_flight):
            self._start()

    def _start(self) -> None:
        if self._left > 0:
            self._left -= 1
            self._call().add_done_callback(self._on_answer)

    def _on_answer(self, _future: Any) -> None:
        self.done += 1
        self._start()

    def end(self) -> None:
        """Make no further calls."""
        self._left = 0


@contextlib.contextmanager
def calling(domain: int) -> Iterator[Caller]:
    """Provide a caller while the block runs."""
    caller = Caller(domain)
    try:
        yield caller
    finally:
        caller.close()


@dataclass(frozen=True)
class RoundTrips:
    """Cost of calls.

    Attributes:
        times: round-trip times.
        cpu: CPU time of the called program per call, in microseconds.
    """

    times: Spread
    cpu: float


class _Recorder:
    """Adds up the cost of calls."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._cpu = 0.0

    def add(self, times: list[float], cpu: float) -> None:
        """Add the round-trip times of some calls and their total CPU time, in seconds."""
        self._times += times
        self._cpu += cpu

    @property
    def round_trips(self) -> RoundTrips:
        """Cost of all calls so far."""
        return RoundTrips(Spread.of(self._times), self._cpu / len(self._times) * MICROSECONDS)


class CalledProgram(_Recorder):
    """A program whose service is called.

    Args:
        program: the program.
        caller: calls it. Its service must be selected.
    """

    def __init__(self, program: Program, caller: Caller) -> None:
        super().__init__()
        self._program = program
        self._caller = caller

    def call(self, count: int) -> None:
        """Call `count` times, after a few calls that are not recorded."""
        with no_garbage_collection():
            self._caller.calls(max(1, count // 10))
            cpu = self._program.cpu
            self.add(self._caller.calls(count), self._program.cpu - cpu)


class WebSocketFloor(_Recorder):
    """Requests and answers over a bare WebSocket."""

    def __init__(self, program: Program) -> None:
        super().__init__()
        self._program = program

    def call(self, count: int) -> None:
        """Send `count` requests, after a few requests that are not recorded."""
        self._program.send(count)
        result = self._program.receive()
        self.add(result["times"], result["cpu"])

    def concurrent(self, count: int, in_flight: int) -> float:
        """Keep `in_flight` requests in flight; return the time that all took, in seconds."""
        self._program.send(count, in_flight)
        return float(self._program.receive())


def call_repeatedly(
    program: Program, caller: Caller, service: Service, count: int, options: Options
) -> RoundTrips:
    """Call one service of a program, one call after the other, and return the cost."""
    caller.use(*service)
    caller.warm_up(1.0 * options.scale)
    called = CalledProgram(program, caller)
    called.call(count)
    return called.round_trips


def measure(domain: int, options: Options) -> Measured:
    """Measure sequential calls of agent and floors in turn, then concurrent calls of the agent."""
    with (
        calling(domain) as caller,
        running_chassis(domain) as (chassis, port),
        running_agent(domain, port, options) as program,
        own_domain() as floor_domain,
        calling(floor_domain) as floor_caller,
        running("benchmarks.floors.service", domain=floor_domain) as floor,
        running_chassis(floor_domain) as (floor_chassis, floor_port),
        running(
            "benchmarks.floors.websocket", f"ws://127.0.0.1:{floor_port}", domain=floor_domain
        ) as socket,
    ):
        for each in (caller, floor_caller):
            each.use(*POSE_SPEED)
            each.warm_up(1.0 * options.scale)
        called_agent = CalledProgram(program, caller)
        called_floors = (CalledProgram(floor, floor_caller), WebSocketFloor(socket))
        for _ in range(options.turns):
            for called in (called_agent, *called_floors):
                called.call(options.samples(2000 // options.turns))
        count = max(options.samples(600), 2 * _CONCURRENT)
        with _delayed(chassis):
            duration = _concurrent(caller, count)
        with _delayed(floor_chassis):
            floor_duration = WebSocketFloor(socket).concurrent(count, _CONCURRENT)
        floor_duration += _concurrent(floor_caller, count)
    trips = called_agent.round_trips
    floors = [called.round_trips for called in called_floors]
    return {
        "service_rtt": _ratio(trips.times.median, [each.times.median for each in floors]),
        "service_rtt_p99": _ratio(trips.times.p99, [each.times.p99 for each in floors]),
        "service_cpu": _ratio(trips.cpu, [each.cpu for each in floors]),
        "concurrent": (
            count / duration / _IDEAL,
            f"{count / duration:.0f} / {_IDEAL:.0f} calls/s, floors {count / floor_duration:.0f}",
        ),
    }


def _ratio(value: float, floors: list[float]) -> tuple[float, str]:
    """Return the value divided by the sum of the floors, and a text with all of them."""
    terms = " + ".join(f"{each:.0f}" for each in floors)
    return value / sum(floors), f"{value:.0f} / ({terms}) µs"


@contextlib.contextmanager
def _delayed(chassis: Program) -> Iterator[None]:
    """Let the chassis answer after `_DELAY` while the block runs."""
    chassis.send("delay", _DELAY)
    yield
    chassis.send("delay", 0)


def _concurrent(caller: Caller, count: int) -> float:
    """Return the time that concurrent calls take, in seconds."""
    caller.concurrent_calls(2 * _CONCURRENT, _CONCURRENT)
    with no_garbage_collection():
        return caller.concurrent_calls(count, _CONCURRENT)
