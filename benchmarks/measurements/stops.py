"""The service stop, while many calls are in flight."""

from __future__ import annotations

import time
from bisect import bisect_left

from std_srvs.srv import Trigger

from benchmarks.figures import Measured, Spread, Target, no_garbage_collection
from benchmarks.measurements.calls import POSE_SPEED, Caller, calling
from benchmarks.options import Options
from benchmarks.processes import Program, running_agent, running_chassis

FIGURES = {
    "stop_latency": Target(
        20.0, 5.0, "ms from a call of `stop` to the zero at the chassis, p99, amid 50 other calls"
    ),
}
_IN_FLIGHT = 50
"""Number of calls that wait for an answer all the time."""
_DELAY = 0.25
"""Delay of the chassis's answers, in seconds."""
_STOPS = 150


def measure(domain: int, options: Options) -> Measured:
    """Measure the time from a call of stop to the zero at the chassis, idle and then busy."""
    count = options.samples(_STOPS)
    with (
        calling(domain) as caller,
        running_chassis(domain) as (chassis, port),
        running_agent(domain, port, options),
        no_garbage_collection(),
    ):
        caller.use(Trigger, "stop")
        idle = Spread.of(_stops(caller, chassis, count))
        caller.use(*POSE_SPEED)
        chassis.send("delay", _DELAY)
        load = caller.start_load(_IN_FLIGHT)
        caller.use(Trigger, "stop", first_timeout=4 * _DELAY)
        busy = Spread.of(_stops(caller, chassis, count))
        load.end()
    return {"stop_latency": (busy.p99 / 1000, f"{busy} µs; without other calls {idle} µs")}


def _stops(caller: Caller, chassis: Program, count: int) -> list[float]:
    """Return the latencies of some stops, one after the other, in seconds."""
    _zeros(chassis)
    called = []
    for _ in range(count):
        called.append(time.monotonic())
        caller.calls(1)
    zeros = _zeros(chassis)
    return [zeros[bisect_left(zeros, begun)] - begun for begun in called]


def _zeros(chassis: Program) -> list[float]:
    """Return the time of each zero velocity since the last call."""
    chassis.send("velocities")
    return [at for linear, at in chassis.receive() if not linear]
