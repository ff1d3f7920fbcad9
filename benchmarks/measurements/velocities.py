"""Velocities on cmd_vel, through the agent and through the floor."""

from __future__ import annotations

import contextlib
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator

from benchmarks.figures import MICROSECONDS, Measured, Spread, Target
from benchmarks.options import Options
from benchmarks.processes import (
    FLOOR,
    Program,
    running,
    running_agent,
    running_chassis,
    running_floor,
)
from benchmarks.programs.velocity_publisher import STEP
from woosh_robot_agent.testing.agents import NAMESPACE

FIGURES = {
    "cmd_vel_latency": Target(1.3, 1.1, "cmd_vel at 20 Hz to the chassis / bare subscriber"),
    "cmd_vel_cpu": Target(1.5, 1.2, "agent's CPU per cmd_vel at 20 Hz / bare subscriber"),
}
RATE = 20.0
"""Rate of the velocities, in Hz; that of most joysticks and of Nav2."""
CMD_VEL = f"{NAMESPACE}/cmd_vel"
_VELOCITIES = 1000
"""Number of velocities in one repetition."""
_TIMEOUT = 10.0
"""Maximum time from the last velocity until it arrives, in seconds; it may also be lost."""


class VelocityPath:
    """The path of velocities: a publisher, the program that forwards them, and a chassis.

    Args:
        publisher: publishes the velocities.
        topic: topic of the program.
        program: the agent or the floor.
        chassis: receives them.
    """

    def __init__(self, publisher: Program, topic: str, program: Program, chassis: Program) -> None:
        self._publisher = publisher
        self._topic = topic
        self._program = program
        self._chassis = chassis
        self._latencies: list[float] = []
        self._sent = 0
        """Number of velocities."""
        self._cpu = 0.0
        """CPU time of the program for all of them, in seconds."""

    def drive(
        self, rate: float, count: int, meanwhile: Callable[[], object] | None = None
    ) -> list[float]:
        """Publish velocities; return their latencies to the chassis, in seconds.

        A newer velocity takes the place of one that waits, so a velocity has arrived when it or a
        newer one has.

        Args:
            rate: rate of the velocities, in Hz.
            count: number of the velocities.
            meanwhile: called again and again while they are published.
        """
        self._arrivals()
        cpu = self._program.cpu
        self._publisher.send("publish", self._topic, rate, count)
        while meanwhile is not None and not self._publisher.has_answer():
            meanwhile()
        sent = self._publisher.receive()
        self._cpu += self._program.cpu - cpu
        self._sent += count
        arrivals = self._arrivals()
        deadline = time.monotonic() + _TIMEOUT
        while (not arrivals or arrivals[-1][0] < count) and time.monotonic() < deadline:
            arrivals += self._arrivals()
        numbers = [number for number, _ in arrivals]
        latencies = []
        for number, at in enumerate(sent, 1):
            index = bisect_left(numbers, number)
            if index < len(arrivals):
                latencies.append(arrivals[index][1] - at)
        self._latencies += latencies
        return latencies

    def _arrivals(self) -> list[tuple[int, float]]:
        """Return number and time of each velocity that has arrived since the last call."""
        self._chassis.send("velocities")
        return [(round(linear / STEP), at) for linear, at in self._chassis.receive() if linear]

    @property
    def latency(self) -> Spread:
        """Latency of all velocities so far."""
        return Spread.of(self._latencies)

    @property
    def cpu_per_velocity(self) -> float:
        """CPU time of the program per velocity, in microseconds."""
        return self._cpu / self._sent * MICROSECONDS

    def forget(self) -> None:
        """Forget what has been recorded, which was a warm-up."""
        self._latencies, self._sent, self._cpu = [], 0, 0.0


@contextlib.contextmanager
def publishing(domain: int, *topics: str) -> Iterator[Program]:
    """Run a publisher of velocities; the block starts when each topic has a subscriber."""
    program = ("benchmarks.programs.velocity_publisher", *topics)
    with running(*program, domain=domain) as publisher:
        publisher.receive()
        yield publisher


def measure(domain: int, options: Options) -> Measured:
    """Measure velocities through agent and floor in turn."""
    topics = (CMD_VEL, f"{FLOOR}/cmd_vel")
    with (
        running_chassis(domain) as (chassis, port),
        running_agent(domain, port, options) as program,
        running_floor("cmd_vel", domain, port) as bare,
        publishing(domain, *topics) as publisher,
    ):
        ours = VelocityPath(publisher, topics[0], program, chassis)
        floor = VelocityPath(publisher, topics[1], bare, chassis)
        for path in (ours, floor):
            path.drive(RATE, options.samples(40))
            path.forget()
        for _ in range(options.turns):
            for path in (ours, floor):
                path.drive(RATE, options.samples(_VELOCITIES // options.turns))
    cpu, floor_cpu = ours.cpu_per_velocity, floor.cpu_per_velocity
    return {
        "cmd_vel_latency": (
            ours.latency.median / floor.latency.median,
            f"{ours.latency} / {floor.latency} µs",
        ),
        "cmd_vel_cpu": (cpu / floor_cpu, f"{cpu:.0f} / {floor_cpu:.0f} µs"),
    }
