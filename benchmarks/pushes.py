"""What the chassis pushes, through the agent and over the floor."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile

from benchmarks.options import TURNS, Measured, Options, Spread
from benchmarks.programs import Program, agent, echo_chassis, running
from tests.harness import NAMESPACE, Client, own_domain, wait_until

TOPIC = "robot/PoseSpeed"
_LATE = 0.1
"""s after its sending at which the last push of a row must be there, else a backlog has grown."""
_LOST = 0.001
"""Share of pushes that may be lost: another program may have had the core for a moment."""
_REACHED = 0.8
"""Share of the rate that must have been sent for a higher one to be tried."""
_TRIES = 3
_POLL = 0.02
_STEP = 1.2
_FIRST_RATE, _LAST_RATE = 500.0, 20_000.0
_QUIET = 2.0


@dataclass(frozen=True)
class Row:
    """A row of pushes, and what became of them.

    Attributes:
        sent: when each was sent, by number.
        came: when each came, by topic and number.
        cpu: CPU time of all publishers in s.
        chassis_cpu, subscriber_cpu: that of what serves to measure.
    """

    sent: dict[int, float]
    came: dict[str, dict[int, float]]
    cpu: float
    chassis_cpu: float
    subscriber_cpu: float

    @classmethod
    def together(cls, rows: Sequence[Row]) -> Row:
        """Rows of the same topics as one."""
        return cls(
            sent={number: at for row in rows for number, at in row.sent.items()},
            came={
                topic: {number: at for row in rows for number, at in row.came[topic].items()}
                for topic in rows[0].came
            },
            cpu=sum(row.cpu for row in rows),
            chassis_cpu=sum(row.chassis_cpu for row in rows),
            subscriber_cpu=sum(row.subscriber_cpu for row in rows),
        )

    @property
    def seconds(self) -> float:
        """From the first to the last."""
        times = list(self.sent.values())
        return times[-1] - times[0]

    @property
    def rate(self) -> float:
        """That which was reached, in Hz."""
        return (len(self.sent) - 1) / self.seconds

    @property
    def share(self) -> float:
        """Share of them that came, on the topic with the most losses."""
        return min(len(came) for came in self.came.values()) / len(self.sent)

    @property
    def latency(self) -> Spread:
        """From the sending to the subscriber's callback, of all topics together."""
        return Spread.of([at - self.sent[i] for c in self.came.values() for i, at in c.items()])

    @property
    def lag(self) -> float:
        """By how much the last was late, in s; infinite where it never came."""
        last = max(self.sent)
        return max(came.get(last, float("inf")) for came in self.came.values()) - self.sent[last]

    @property
    def cpu_each(self) -> float:
        """The publishers' CPU per push and topic in µs."""
        return self.cpu / len(self.sent) / len(self.came) * 1e6


class Line:
    """A chassis that pushes, what publishes that, and who gets it."""

    def __init__(
        self, chassis: Program, publishers: Sequence[Program], subscribers: Sequence[Program]
    ) -> None:
        self.chassis = chassis
        self.publishers = publishers
        self.subscribers = subscribers
        self._next = 1

    def warm(self, seconds: float) -> None:
        """Return when all have found each other, and then after a while of 100 Hz."""
        wait_until(lambda: self.push(100.0, 3, quiet=0.3).share == 1.0, "the pushes", 60.0)
        self.push(100.0, max(1, int(100 * seconds)))

    def push(self, rate: float, count: int, *, poll: float = 0.0, quiet: float = _QUIET) -> Row:
        """Push for a while, and wait until the last has come or nothing comes any more.

        Args:
            rate: in Hz.
            count: of pushes.
            poll: s after which subscribers look for the newest; 0 has them take each at once.
            quiet: s of silence, beside the pushes' own, after which nothing more is waited for.
        """
        first, self._next = self._next, self._next + count
        before = self._cpu()
        for subscriber in self.subscribers:
            subscriber.tell("take", self._next - 1, quiet + 1 / rate, poll)
        self.chassis.tell("push", rate, first, count)
        told = self.chassis.read()
        came = [subscriber.read() for subscriber in self.subscribers]
        agents, others = (now - then for now, then in zip(self._cpu(), before, strict=True))
        return Row(
            sent=dict(enumerate(told["sent"], start=first)),
            # what is older was latched, or the row before
            came={
                topic: {number: at for number, at in pairs if number >= first}
                for each in came
                for topic, pairs in each.items()
            },
            cpu=agents,
            chassis_cpu=told["cpu"],
            subscriber_cpu=others,
        )

    def _cpu(self) -> tuple[float, float]:
        return sum(p.cpu for p in self.publishers), sum(s.cpu for s in self.subscribers)


@contextlib.contextmanager
def line(
    domain: int, options: Options, *, floor: bool = False, odom: bool = False
) -> Iterator[Line]:
    """The agent or the floor, one subscriber, and all of them warm.

    Args:
        domain: ROS_DOMAIN_ID.
        options: how to measure.
        floor: without the agent.
        odom: the agent publishes odom with each push, as it does by default; the floor has none.
    """
    with (
        subscribing(domain, NAMESPACE) as subscriber,
        echo_chassis(domain, "websocket" if floor else options.transport) as (chassis, port),
        running("benchmarks.floors.publish", f"ws://127.0.0.1:{port}", domain=domain)
        if floor
        else agent(domain, port, options, enable_odom=odom) as program,
    ):
        made = Line(chassis, [program], [subscriber])
        made.warm(2.0 * options.scale)
        yield made


@contextlib.contextmanager
def subscribing(domain: int, *namespaces: str) -> Iterator[Program]:
    """A subscriber to PoseSpeed of some robots."""
    topics = [f"{namespace}/{TOPIC}" for namespace in namespaces]
    with running("benchmarks.subscriber", *topics, domain=domain) as program:
        yield program


def pushes(domain: int, options: Options) -> Measured:
    """PoseSpeed at 100 Hz by turns, and the highest rate. odom is off: the floor has none."""
    with (
        own_domain() as other,
        line(domain, options) as agents,
        line(other, options, floor=True) as floors,
        _drops(domain) as drops,
    ):
        drops()  # who looks at /diagnostics is known before anything is timed
        turns = [
            (agents.push(100.0, count), floors.push(100.0, count))
            for count in [options.count(1000 // TURNS)] * TURNS
        ]
        best = _highest_rate(agents, drops, options), _highest_rate(floors, lambda: 0, options)
    ours, bare = (Row.together(rows) for rows in zip(*turns, strict=True))
    return {
        "push_latency": (
            ours.latency.median / bare.latency.median,
            f"{ours.latency} / {bare.latency} µs",
        ),
        "push_cpu": (
            ours.cpu_each / bare.cpu_each,
            f"{ours.cpu_each:.0f} / {bare.cpu_each:.0f} µs",
        ),
        "push_max": (best[0] / best[1], f"{best[0]:.0f} / {best[1]:.0f} Hz"),
    }


def _highest_rate(made: Line, drops: Callable[[], int], options: Options) -> float:
    """The highest rate reached that is forwarded without loss and without a growing backlog, in Hz.

    Loss is what the publisher itself leaves out. The topic's queue holds one message, so what a
    subscriber misses says nothing of the publisher; the floor has the same queue.
    """
    rate, best, tries, dropped = _FIRST_RATE, 0.0, 0, drops()
    while rate <= _LAST_RATE and tries < _TRIES:
        row = made.push(rate, options.count(int(2 * rate)), poll=_POLL)
        before, dropped = dropped, drops()
        if dropped - before <= _LOST * len(row.sent) and row.lag <= _LATE:
            best = max(best, row.rate)
            rate, tries = (rate * _STEP, 0) if row.rate > _REACHED * rate else (rate, tries + 1)
        else:
            tries += 1
        if options.smoke:
            break
    return best or _FIRST_RATE / _STEP


@contextlib.contextmanager
def _drops(domain: int) -> Iterator[Callable[[], int]]:
    """The pushes that the agent counts as dropped, as of now."""
    client = Client(domain)
    seen = client.echo_with(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))

    def drops() -> int:
        now = time.time()
        message = seen.wait(lambda m: m.header.stamp.sec + m.header.stamp.nanosec / 1e9 >= now)
        values: dict[str, Any] = {v.key: v.value for s in message.status for v in s.values}
        return int(values["drops"])

    try:
        yield drops
    finally:
        client.close()
