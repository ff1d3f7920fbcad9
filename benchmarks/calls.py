"""Service calls through the agent, and over the floors."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile

from benchmarks.options import TURNS, Measured, Options, Spread
from benchmarks.programs import Program, agent, echo_chassis, no_collection, running
from tests.harness import NAMESPACE, own_domain, wait_until
from woosh_robot_msgs.srv import PoseSpeed, ScannerData

_DELAY = 0.05
_AT_A_TIME = 10


class Caller:
    """Calls services of the agent, by an executor of its own in this thread.

    It had best be there before the agent: DDS finds who comes last the soonest.
    """

    def __init__(self, domain: int) -> None:
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node(f"caller_{domain}", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._srv: Any = None
        self._client: Any = None

    def use(self, srv: Any, name: str) -> None:
        """Call this service from now on; returns when it answers."""
        if self._client is not None:
            self._node.destroy_client(self._client)
        self._srv = srv
        self._client = self._node.create_client(
            srv, f"{NAMESPACE}/{name}", qos_profile=QoSProfile(depth=1000)
        )
        wait_until(self._client.service_is_ready, "the service", 30.0)
        # ready as it is, the way back may not be known to the server yet
        wait_until(lambda: self._call(0.2), "the first answer", 30.0)

    def warm(self, seconds: float) -> None:
        """Call for a while, until both ends know each other and all is in the caches."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.calls(5)

    def calls(self, count: int) -> list[float]:
        """Round trips in s, one after the other."""
        times = []
        for _ in range(count):
            begun = time.perf_counter()
            if not self._call(30.0):
                raise AssertionError("a call was not answered")
            times.append(time.perf_counter() - begun)
        return times

    def _call(self, timeout: float) -> bool:
        """Whether a call was answered in time."""
        deadline = time.monotonic() + timeout
        future = self._client.call_async(self._srv.Request())
        while not future.done() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=timeout)
        return bool(future.done())

    def outstanding(self, count: int, at_a_time: int) -> float:
        """Time in s for `count` calls, of which so many are under way at any time."""
        begun = time.perf_counter()
        started = done = 0

        def start() -> None:
            nonlocal started
            if started < count:
                started += 1
                self._client.call_async(self._srv.Request()).add_done_callback(finished)

        def finished(_future: Any) -> None:
            nonlocal done
            done += 1
            start()

        for _ in range(at_a_time):
            start()
        deadline = time.monotonic() + 60.0
        while done < count:
            if time.monotonic() > deadline:
                raise AssertionError(f"{done} of {count} calls were answered")
            self._executor.spin_once(timeout_sec=5.0)
        return time.perf_counter() - begun

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


@contextlib.contextmanager
def calling(domain: int) -> Iterator[Caller]:
    """A caller, closed at the end."""
    caller = Caller(domain)
    try:
        yield caller
    finally:
        caller.close()


@dataclass(frozen=True)
class Trips:
    """What calls cost, in µs: each by itself, and the program's CPU per call."""

    times: Spread
    cpu: float


Service = tuple[Any, str]
POSE_SPEED: Service = (PoseSpeed, "robot/PoseSpeed")
SCAN: Service = (ScannerData, "robot/ScannerData")


class _Taken:
    """What calls took, added up."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._cpu = 0.0

    def add(self, times: list[float], cpu: float) -> None:
        """Some more calls, each in s, and the CPU time of all of them in s."""
        self._times += times
        self._cpu += cpu

    @property
    def trips(self) -> Trips:
        """All of them."""
        return Trips(Spread.of(self._times), self._cpu / len(self._times) * 1e6)


class Called(_Taken):
    """A program that is called from time to time.

    Args:
        program: which one.
        caller: who calls it; it uses the service already.
    """

    def __init__(self, program: Program, caller: Caller) -> None:
        super().__init__()
        self._program = program
        self._caller = caller

    def call(self, count: int) -> None:
        """Call it so many times, one after the other, and some before that do not count."""
        with no_collection():
            self._caller.calls(max(1, count // 10))
            cpu = self._program.cpu
            self.add(self._caller.calls(count), self._program.cpu - cpu)


def trips(
    program: Program, caller: Caller, service: Service, count: int, options: Options
) -> Trips:
    """Calls of one service, one after the other."""
    caller.use(*service)
    caller.warm(1.0 * options.scale)
    called = Called(program, caller)
    called.call(count)
    return called.trips


class Socket(_Taken):
    """The floor of the link: requests and answers over a WebSocket, and nothing else."""

    def __init__(self, program: Program) -> None:
        super().__init__()
        self._program = program

    def call(self, count: int) -> None:
        """Ask so many times, one after the other, and some before that do not count."""
        self._program.tell(count)
        result = self._program.read()
        self.add(result["times"], result["cpu"])


def services(domain: int, options: Options) -> Measured:
    """Calls one after the other, agent and floors by turns; then several at a time."""
    with (
        calling(domain) as caller,
        echo_chassis(domain, options.transport) as (chassis, port),
        agent(domain, port, options) as program,
        own_domain() as other,
        calling(other) as bare_caller,
        running("benchmarks.floors.service", domain=other) as floor,
        echo_chassis(other, "websocket") as (_, bare_port),
        running(
            "benchmarks.floors.websocket", f"ws://127.0.0.1:{bare_port}", domain=other
        ) as socket,
    ):
        for each in (caller, bare_caller):
            each.use(*POSE_SPEED)
            each.warm(1.0 * options.scale)
        ours, bare, wire = Called(program, caller), Called(floor, bare_caller), Socket(socket)
        for _ in range(TURNS):
            for called in (ours, bare, wire):
                called.call(options.count(2000 // TURNS))
        concurrent = _concurrent(chassis, caller, options.count(600))
    through, floors = ours.trips, (bare.trips, wire.trips)
    return {
        "service_rtt": _over(through.times.median, [each.times.median for each in floors]),
        "service_rtt_p99": _over(through.times.p99, [each.times.p99 for each in floors]),
        "service_cpu": _over(through.cpu, [each.cpu for each in floors]),
        "concurrent": concurrent,
    }


def _over(ours: float, floors: list[float]) -> tuple[float, str]:
    bare = " + ".join(f"{each:.0f}" for each in floors)
    return ours / sum(floors), f"{ours:.0f} / ({bare}) µs"


def _concurrent(chassis: Program, caller: Caller, count: int) -> tuple[float, str]:
    """Ten calls at a time to a chassis that takes 50 ms for each: throughput / ideal."""
    chassis.tell("delay", _DELAY)
    caller.outstanding(2 * _AT_A_TIME, _AT_A_TIME)
    count = max(count, 2 * _AT_A_TIME)
    with no_collection():
        took = caller.outstanding(count, _AT_A_TIME)
    chassis.tell("delay", 0)
    ideal = count / _AT_A_TIME * _DELAY
    return ideal / took, f"{count / took:.0f} / {_AT_A_TIME / _DELAY:.0f} calls/s"
