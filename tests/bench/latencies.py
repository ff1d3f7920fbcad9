"""Calls and pushes through the agent, and over the floors."""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from harness import Client, wait_until
from rclpy.qos import QoSProfile

from bench.programs import Program, agent_command, echo_chassis, running
from woosh_robot_msgs.msg import PoseSpeed as PoseSpeedMsg
from woosh_robot_msgs.srv import PoseSpeed

if TYPE_CHECKING:
    from bench.speed import Options

_US = 1e6
_DELAY = 0.05


def percentile(values: Sequence[float], share: float) -> float:
    """The value below which `share` of them are."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


class Caller:
    """Calls robot/PoseSpeed, one call after the other, by an executor of its own in this thread."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor

        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("caller", context=self._context)
        self._client = self._node.create_client(
            PoseSpeed, "/woosh_robot/robot/PoseSpeed", qos_profile=QoSProfile(depth=1000)
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        wait_until(self._client.service_is_ready, "the service", 30.0)
        # ready as it is, the way back may not be known to the server yet
        wait_until(lambda: self._call(1.0), "the first answer", 30.0)

    def calls(self, count: int) -> list[float]:
        """Round trips in s."""
        times = []
        for _ in range(count):
            begun = time.perf_counter()
            if not self._call(30.0):
                raise RuntimeError("a call was not answered")
            times.append(time.perf_counter() - begun)
        return times

    def _call(self, timeout: float) -> bool:
        """Whether a call was answered in time."""
        deadline = time.monotonic() + timeout
        future = self._client.call_async(PoseSpeed.Request())
        while not future.done() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=timeout)
        return bool(future.done())

    def outstanding(self, count: int, at_a_time: int) -> float:
        """Time in s for `count` calls, of which so many are under way at any time."""
        begun = time.perf_counter()
        started = [0]
        done = [0]

        def start() -> None:
            if started[0] < count:
                started[0] += 1
                self._client.call_async(PoseSpeed.Request()).add_done_callback(finished)

        def finished(_future: Any) -> None:
            done[0] += 1
            start()

        for _ in range(at_a_time):
            start()
        while done[0] < count:
            self._executor.spin_once(timeout_sec=5.0)
        return time.perf_counter() - begun

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


def _measured(program: Program, caller: Caller, count: int) -> tuple[list[float], float]:
    """Round trips, and the program's CPU per call, both in s."""
    caller.calls(max(5, count // 10))
    cpu = program.cpu
    times = caller.calls(count)
    return times, (program.cpu - cpu) / count


def services(domain: int, options: Options) -> dict[str, tuple[float, str]]:
    """Calls one after the other."""
    count = options.count(2000)
    with echo_chassis(domain, "--transport", options.transport) as (_, port):
        with running(
            *agent_command(port, options.executor, **options.link), domain=domain
        ) as agent:
            caller = Caller(domain)
            wait_connected(agent, caller)
            through, through_cpu = _measured(agent, caller, count)
            caller.close()
        with running("bench.floors.service", options.executor, domain=domain) as floor:
            caller = Caller(domain)
            bare, bare_cpu = _measured(floor, caller, count)
            caller.close()
    with echo_chassis(domain) as (_, port):
        url = f"ws://127.0.0.1:{port}"
        with running("bench.floors.websocket", url, str(count), domain=domain) as socket:
            result = socket.read()
    trips, socket_cpu = result["times"], result["cpu"] / count
    medians = [statistics.median(times) * _US for times in (through, bare, trips)]
    p99s = [percentile(times, 0.99) * _US for times in (through, bare, trips)]
    cpus = [each * _US for each in (through_cpu, bare_cpu, socket_cpu)]
    return {
        name: (a / (b + c), f"{a:.0f} / ({b:.0f} + {c:.0f}) µs")
        for name, (a, b, c) in (
            ("service_rtt", medians),
            ("service_rtt_p99", p99s),
            ("service_cpu", cpus),
        )
    }


def wait_connected(agent: Program, caller: Caller) -> None:
    """Return when calls really go through to the chassis."""
    wait_until(lambda: caller.calls(1) and agent.process.poll() is None, "the agent")
    caller.calls(20)


def concurrency(domain: int, options: Options) -> dict[str, tuple[float, str]]:
    """Ten calls at a time to a chassis that takes 50 ms for each."""
    count = options.count(600)
    with (
        echo_chassis(domain, "--delay", str(_DELAY), "--transport", options.transport) as (_, port),
        running(*agent_command(port, options.executor, **options.link), domain=domain),
    ):
        caller = Caller(domain)
        caller.outstanding(20, 10)
        took = caller.outstanding(count, 10)
        caller.close()
    ideal = count / 10 * _DELAY
    return {"concurrent": (ideal / took, f"{count / took:.0f} of {10 / _DELAY:.0f} calls/s")}


class Pushed:
    """Subscribes to robot/PoseSpeed and notes when each number came."""

    def __init__(self, domain: int) -> None:
        self.received: dict[int, float] = {}
        self._client = Client(domain)
        self._client.node.create_subscription(
            PoseSpeedMsg, "/woosh_robot/robot/PoseSpeed", self._take, QoSProfile(depth=5000)
        )
        self._changed = threading.Event()

    def _take(self, message: PoseSpeedMsg) -> None:
        self.received[message.mileage] = time.monotonic()
        self._changed.set()

    def wait_matched(self) -> None:
        wait_until(lambda: self._client.publishers("robot/PoseSpeed"), "the publisher", 30.0)

    def wait_quiet(self) -> None:
        """Return when nothing has come for half a second."""
        while self._changed.wait(0.5):
            self._changed.clear()

    def close(self) -> None:
        self._client.close()


def _push(
    domain: int,
    options: Options,
    publisher: Sequence[str],
    port: int,
    chassis: Program,
    rates: Sequence[tuple[float, int]],
) -> list[tuple[list[float], float, float]]:
    """For each rate: latencies in s, the publisher's CPU per push in s, the share that came."""
    results = []
    with running(*publisher, domain=domain) as program:
        pushed = Pushed(domain)
        pushed.wait_matched()
        subscribed = False
        while not subscribed:  # until its subscription has reached the chassis
            chassis.tell("push 50 5")
            chassis.read()
            pushed.wait_quiet()
            subscribed = bool(pushed.received)
        for rate, count in rates:
            pushed.received.clear()
            cpu = program.cpu
            chassis.tell(f"push {rate} {count}")
            sent = chassis.read()["sent"]
            pushed.wait_quiet()
            came = pushed.received
            latencies = [came[i] - at for i, at in enumerate(sent, start=1) if i in came]
            results.append((latencies, (program.cpu - cpu) / count, len(came) / count))
        pushed.close()
    return results


def _publishers(port: int, options: Options) -> dict[str, list[str]]:
    return {
        "agent": agent_command(port, options.executor, enable_odom=False, **options.link),
        "floor": ["bench.floors.publish", f"ws://127.0.0.1:{port}"],
    }


def pushes(domain: int, options: Options) -> dict[str, tuple[float, str]]:
    """PoseSpeed at 100 Hz. odom, which is published with it, is off: the floor has none."""
    count = options.count(1000)
    found = {}
    for name in ("agent", "floor"):
        transport = options.transport if name == "agent" else "websocket"
        with echo_chassis(domain, "--transport", transport) as (chassis, port):
            command = _publishers(port, options)[name]
            ((times, cpu, _),) = _push(domain, options, command, port, chassis, [(100.0, count)])
            found[name] = (statistics.median(times) * _US, cpu * _US)
    return {
        name: (
            found["agent"][i] / found["floor"][i],
            f"{found['agent'][i]:.0f} / {found['floor'][i]:.0f} µs",
        )
        for i, name in enumerate(("push_latency", "push_cpu"))
    }


def push_rates(domain: int, options: Options) -> dict[str, tuple[float, str]]:
    """The highest rate of which 99.9 % arrive."""
    ladder = [250, 500, 750, 1000, 1500, 2000, 3000, 4000, 6000, 8000]
    if options.scale < 1:
        ladder = ladder[:2]
    best = {}
    for name in ("agent", "floor"):
        transport = options.transport if name == "agent" else "websocket"
        with echo_chassis(domain, "--transport", transport) as (chassis, port):
            command = _publishers(port, options)[name]
            rates = [(float(rate), options.count(2 * rate)) for rate in ladder]
            shares = [r[2] for r in _push(domain, options, command, port, chassis, rates)]
            kept = [rate for rate, share in zip(ladder, shares, strict=True) if share >= 0.999]
            best[name] = max(kept, default=ladder[0])
    return {"push_max": (best["agent"] / best["floor"], f"{best['agent']} / {best['floor']} Hz")}
