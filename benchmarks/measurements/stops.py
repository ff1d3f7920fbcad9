"""The service stop, while many calls are in flight."""

from __future__ import annotations

import time

from std_srvs.srv import Trigger

from benchmarks.measurements.calls import POSE_SPEED, Caller, calling
from benchmarks.measurements.samples import Measured, Spread, no_garbage_collection
from benchmarks.options import Options
from benchmarks.processes import Program
from benchmarks.programs.start import agent, echo_chassis
from woosh_robot_agent.testing import own_domain

_IN_FLIGHT = 50
"""Number of calls that wait for an answer all the time."""
_DELAY = 0.25
"""Delay of the chassis's answers, in seconds."""
_STOPS = 150
_MILLISECOND = 1000
"""Microseconds in a millisecond."""


def measure(domain: int, options: Options) -> Measured:
    """Measure the time from a call of stop to the zero at the chassis, busy and idle in turn."""
    with (
        calling(domain) as caller,
        own_domain() as idle_domain,
        calling(idle_domain) as idle_caller,
        echo_chassis(domain, options.transport) as (chassis, port),
        echo_chassis(idle_domain, options.transport) as (idle_chassis, idle_port),
        agent(domain, port, options),
        agent(idle_domain, idle_port, options),
        no_garbage_collection(),
    ):
        idle_caller.use(Trigger, "stop")
        caller.use(*POSE_SPEED)
        chassis.send("delay", _DELAY)
        load = caller.start_load(_IN_FLIGHT)
        caller.use(Trigger, "stop", first_timeout=4 * _DELAY)
        busy: list[float] = []
        idle: list[float] = []
        for _ in range(options.turns):
            count = options.samples(_STOPS // options.turns)
            busy += _stops(caller, chassis, count)
            idle += _stops(idle_caller, idle_chassis, count)
        load.end()
    latency, idle_latency = Spread.of(busy), Spread.of(idle)
    return {
        "stop_latency": (
            latency.p99 / _MILLISECOND,
            f"{latency} µs; without other calls {idle_latency} µs",
        )
    }


def _stops(caller: Caller, chassis: Program, count: int) -> list[float]:
    """Return the latencies of some stops, one after the other, in seconds."""
    _zeros(chassis)
    called = []
    for _ in range(count):
        called.append(time.monotonic())
        caller.calls(1)
    return [at - begun for begun, at in zip(called, _zeros(chassis), strict=True)]


def _zeros(chassis: Program) -> list[float]:
    """Return the time of each zero velocity since the last call."""
    chassis.send("velocities")
    return [at for linear, at in chassis.receive() if not linear]
