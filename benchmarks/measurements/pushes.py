"""Pushes of the chassis through the agent and through the floor."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile

from benchmarks.figures import MICROSECONDS, Measured, Spread, Target
from benchmarks.options import Options
from benchmarks.processes import Program, running, running_agent, running_chassis
from tests.harness import Client
from woosh_robot_agent.testing import own_domain, wait_until
from woosh_robot_agent.testing.agents import NAMESPACE

FIGURES = {
    "push_latency": Target(1.1, 1.05, "push to subscriber at 100 Hz / bare publish"),
    "push_cpu": Target(1.2, 1.1, "agent's CPU per push at 100 Hz / bare publish"),
    "push_max": Target(0.8, 0.9, "highest rate without loss / bare publish's", True),
}
TOPIC = "robot/PoseSpeed"
_MAX_LAG = 0.1
"""Latency of the last push above which there is a growing backlog, in seconds."""
_MAX_LOSS = 0.001
"""Share of the pushes that may be lost, because other programs use the machine too."""
_MIN_REACHED = 0.8
"""Share of a rate that must be reached before a higher rate is tried."""
_TRIES = 3
"""Number of failed runs in succession after which no higher rate is tried."""
_POLL = 0.02
"""Polling period of the subscriber while the highest rate is sought, in seconds."""
_STEP = 1.2
"""Factor from one rate to the next."""
_FIRST_RATE, _LAST_RATE = 500.0, 20_000.0
"""Rates between which the highest one is sought, in Hz."""
_QUIET = 2.0
"""Time without a push after which the rest counts as lost, in seconds."""


@dataclass(frozen=True)
class PushRun:
    """A run of consecutive pushes.

    Attributes:
        sent: time of each push, by its number.
        received: arrival times by topic and number.
        cpu: CPU time of all publishers, in seconds.
        chassis_cpu: CPU time of the chassis, in seconds.
        subscriber_cpu: CPU time of all subscribers, in seconds.
    """

    sent: dict[int, float]
    received: dict[str, dict[int, float]]
    cpu: float
    chassis_cpu: float
    subscriber_cpu: float

    @classmethod
    def merge(cls, runs: Sequence[PushRun]) -> PushRun:
        """Combine runs over the same topics into one."""
        return cls(
            sent={number: at for run in runs for number, at in run.sent.items()},
            received={
                topic: {number: at for run in runs for number, at in run.received[topic].items()}
                for topic in runs[0].received
            },
            cpu=sum(run.cpu for run in runs),
            chassis_cpu=sum(run.chassis_cpu for run in runs),
            subscriber_cpu=sum(run.subscriber_cpu for run in runs),
        )

    @property
    def duration(self) -> float:
        """Time from the first push to the last, in seconds."""
        times = list(self.sent.values())
        return times[-1] - times[0]

    @property
    def rate(self) -> float:
        """Rate that the chassis reached, in Hz."""
        return (len(self.sent) - 1) / self.duration

    @property
    def received_share(self) -> float:
        """Share of the pushes that arrived, on the topic with the most losses."""
        return min(len(received) for received in self.received.values()) / len(self.sent)

    @property
    def latency(self) -> Spread:
        """Latency from the chassis to the subscriber's callback, on all topics together."""
        return Spread.of(
            [
                at - self.sent[number]
                for received in self.received.values()
                for number, at in received.items()
            ]
        )

    @property
    def lag(self) -> float:
        """Latency of the last push, in seconds; infinite if it never arrived."""
        last = max(self.sent)
        arrivals = (received.get(last, math.inf) for received in self.received.values())
        return max(arrivals) - self.sent[last]

    @property
    def cpu_per_push(self) -> float:
        """CPU time of the publishers per push and topic, in microseconds."""
        return self.cpu / len(self.sent) / len(self.received) * MICROSECONDS

    def percent(self, cpu: float) -> float:
        """Return CPU time of this run, given in seconds, as percent of one core."""
        return 100 * cpu / self.duration


class PushPath:
    """The path of pushes: a chassis, the programs that publish them, and the subscribers."""

    def __init__(
        self, chassis: Program, publishers: Sequence[Program], subscribers: Sequence[Program]
    ) -> None:
        self.chassis = chassis
        self.publishers = publishers
        self.subscribers = subscribers
        self._next = 1

    def warm_up(self, seconds: float) -> None:
        """Wait until discovery is over, then push at 100 Hz for a while."""
        wait_until(lambda: self.push(100.0, 3, quiet=0.3).received_share == 1.0, "the pushes", 60.0)
        self.push(100.0, max(1, int(100 * seconds)))

    def push(self, rate: float, count: int, *, poll: float = 0.0, quiet: float = _QUIET) -> PushRun:
        """Push, and wait until the last push has arrived or no more pushes arrive.

        Args:
            rate: rate of the pushes, in Hz.
            count: number of the pushes.
            poll: polling period of the subscribers, in seconds; with 0 they take each push at once.
            quiet: time without an arrival after which the rest counts as lost, beyond the period
                of the pushes, in seconds.
        """
        first, self._next = self._next, self._next + count
        before = self._cpu()
        for subscriber in self.subscribers:
            subscriber.send("take", self._next - 1, quiet + 1 / rate, poll)
        self.chassis.send("push", rate, first, count)
        report = self.chassis.receive()
        arrivals = [subscriber.receive() for subscriber in self.subscribers]
        cpu, subscriber_cpu = (now - then for now, then in zip(self._cpu(), before, strict=True))
        return PushRun(
            sent=dict(enumerate(report["sent"], start=first)),
            # older pushes were latched, or belong to the previous run
            received={
                topic: {number: at for number, at in pairs if number >= first}
                for each in arrivals
                for topic, pairs in each.items()
            },
            cpu=cpu,
            chassis_cpu=report["cpu"],
            subscriber_cpu=subscriber_cpu,
        )

    def _cpu(self) -> tuple[float, float]:
        return sum(p.cpu for p in self.publishers), sum(s.cpu for s in self.subscribers)


@contextlib.contextmanager
def push_path(
    domain: int, options: Options, *, floor: bool = False, odom: bool = False
) -> Iterator[PushPath]:
    """Provide a warmed-up path through the agent or the floor, with one subscriber.

    Args:
        domain: ROS_DOMAIN_ID.
        options: options of the measurement.
        floor: use the floor instead of the agent.
        odom: let the agent publish odom, as it does by default.
    """
    transport = "websocket" if floor else options.transport
    with (
        subscribing(domain, NAMESPACE) as subscriber,
        running_chassis(domain, transport=transport) as (chassis, port),
        running("benchmarks.floors.publish", f"ws://127.0.0.1:{port}", domain=domain)
        if floor
        else running_agent(
            domain, port, options, disabled_parts=["" if odom else "odom"]
        ) as program,
    ):
        path = PushPath(chassis, [program], [subscriber])
        path.warm_up(2.0 * options.scale)
        yield path


@contextlib.contextmanager
def subscribing(domain: int, *namespaces: str) -> Iterator[Program]:
    """Run a subscriber to PoseSpeed of the robots in some namespaces."""
    topics = [f"{namespace}/{TOPIC}" for namespace in namespaces]
    with running("benchmarks.programs.pose_subscriber", *topics, domain=domain) as program:
        yield program


def measure(domain: int, options: Options) -> Measured:
    """Measure PoseSpeed at 100 Hz with agent and floor in turn, then the highest rate.

    odom is off, because the floor does not publish it.
    """
    with (
        own_domain() as floor_domain,
        push_path(domain, options) as agent_path,
        push_path(floor_domain, options, floor=True) as floor_path,
        _drop_counter(domain) as drops,
    ):
        drops()  # returns once its subscriber is discovered, so that this is not timed
        turns = [
            (agent_path.push(100.0, count), floor_path.push(100.0, count))
            for count in [options.samples(1000 // options.turns)] * options.turns
        ]
        agent_max = _highest_rate(agent_path, drops, options)
        floor_max = _highest_rate(floor_path, lambda: 0, options)
    ours, floor = (PushRun.merge(runs) for runs in zip(*turns, strict=True))
    return {
        "push_latency": (
            ours.latency.median / floor.latency.median,
            f"{ours.latency} / {floor.latency} µs",
        ),
        "push_cpu": (
            ours.cpu_per_push / floor.cpu_per_push,
            f"{ours.cpu_per_push:.0f} / {floor.cpu_per_push:.0f} µs",
        ),
        "push_max": (agent_max / floor_max, f"{agent_max:.0f} / {floor_max:.0f} Hz"),
    }


def _highest_rate(path: PushPath, drops: Callable[[], int], options: Options) -> float:
    """Return the highest rate that is published without loss and without a backlog, in Hz.

    Only losses that the publisher counts matter. The topic keeps one message, for the agent and for
    the floor, so a subscriber that misses some says nothing about the publisher.
    """
    rate, best, tries, dropped = _FIRST_RATE, 0.0, 0, drops()
    while rate <= _LAST_RATE and tries < _TRIES:
        run = path.push(rate, options.samples(int(2 * rate)), poll=_POLL)
        before, dropped = dropped, drops()
        if dropped - before <= _MAX_LOSS * len(run.sent) and run.lag <= _MAX_LAG:
            best = max(best, run.rate)
            rate, tries = (rate * _STEP, 0) if run.rate > _MIN_REACHED * rate else (rate, tries + 1)
        else:
            tries += 1
        if options.smoke:
            break
    return best or _FIRST_RATE / _STEP


@contextlib.contextmanager
def _drop_counter(domain: int) -> Iterator[Callable[[], int]]:
    """Provide a function that returns how many pushes the agent has dropped so far."""
    client = Client(domain)
    diagnostics = client.echo_with(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))

    def drops() -> int:
        now = time.time()
        message = diagnostics.wait(
            lambda m: m.header.stamp.sec + m.header.stamp.nanosec / 1e9 >= now
        )
        values: dict[str, Any] = {v.key: v.value for s in message.status for v in s.values}
        return int(values["drops"])

    try:
        yield drops
    finally:
        client.close()
