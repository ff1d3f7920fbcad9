"""`scripts/bench --soak`: check that nothing grows in an hour of mixed traffic and faults.

The agent runs in a process of its own. What it holds at rest is compared: early in the run, and at
the end, with samples in between. At rest means that traffic and faults have stopped, every call is
answered and every goal has ended, so nothing in flight is mistaken for growth.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import random
import statistics
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray

from benchmarks.figures import Figure, markdown, print_and_judge
from benchmarks.processes import MIB
from benchmarks.robustness.agent_process import DebugAgentProcess, connected_agent
from benchmarks.robustness.traffic import DuplicateAnswers, Traffic
from tests.harness import Client
from tests.quick_chassis import quick_config
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import TOPICS, Topic
from woosh_robot_agent.pb.robot.robot_pb2 import Scene
from woosh_robot_agent.ros.qos import latched
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.faults import FAULTS
from woosh_robot_agent.testing import own_domain, wait_until
from woosh_robot_msgs.msg import Twist as TwistMsg
from woosh_robot_msgs.srv import Twist

SPEED = 20
"""Speed of the simulated chassis, as a multiple of real time."""
PARAMETERS: dict[str, Any] = {
    "poll_timeout": 3000,
    "liveness_timeout": 4.0,
    "goal_link_timeout": 2.0,
    "result_timeout": 5,
}
"""Parameters of the agent: timeouts so short that faults of a few seconds have an effect."""
REQUEST_WEIGHTS = {
    "query": 10,
    "twist": 6,
    "speak": 4,
    "set_sound": 1,
    "light": 1,
    "task": 1,
    "step": 1,
    "lift": 1,
    "cancel": 1,
}
"""Requests of the user, as methods of `Traffic`, and their relative frequencies."""
REQUEST_PERIOD = 0.1
"""Time between two requests, in seconds."""
LARGE_PUSH_PERIOD = 10.0
"""Time between two large pushes, and between two changes of the subscribers, in seconds."""
LARGE_PUSHES = (1, 10)
"""Smallest and largest size of a large push, in MiB."""
FAULT_ARGUMENTS: dict[str, dict[str, Any]] = {
    "oversize": {"count": 1},
    "truncated": {"where": "wire", "count": 1},
    "burst": {"count": 5000},
}
"""Arguments of the faults whose defaults are unsuitable for a soak."""
FAULT_DURATION = 5.0
"""Longest duration of a fault, in seconds of real time."""
_COUNTERS = ("connects", "rx", "tx", "bad_frames", "dropped_pushes", "timeouts", "late_answers")


@dataclass(frozen=True)
class Length:
    """Length of a soak.

    Attributes:
        seconds: duration of the traffic, in seconds of real time.
        fault_every: time from one fault to the next, in seconds.
        reference_after: time after which the reference is taken that the end is compared with, and
            between two samples at rest, in seconds.
        sample_every: time between two samples under load, in seconds.
        samples_at_rest: number of samples at rest, one per second, of which the median counts.
        rest_timeout: time that the agent gets to come to rest, in seconds.
        max_growth: highest memory at the end, as a multiple of the reference.
    """

    seconds: float = 3600.0
    fault_every: float = 30.0
    reference_after: float = 300.0
    sample_every: float = 10.0
    samples_at_rest: int = 7
    rest_timeout: float = 60.0
    max_growth: float = 1.1


@dataclass(frozen=True)
class Sample:
    """Resources of the agent at one moment.

    Attributes:
        time: time since the start, in seconds.
        rss: resident memory, in bytes.
        held: number of everything else that must not grow, as `DebugAgentProcess.held` returns it.
    """

    time: float
    rss: int
    held: dict[str, int]


class Soak:
    """One run.

    Attributes:
        samples: samples under load.
        rests: samples at rest. The first one is the reference.
        calls: number of calls that were answered.
        goals: number of goals that ended.
        messages: number of messages on each topic.
        faults: number of injections of each fault.
    """

    def __init__(
        self,
        domain: int,
        simulator: SimulatorThread,
        agent: DebugAgentProcess,
        length: Length,
        seed: int,
    ) -> None:
        self.samples: list[Sample] = []
        self.rests: list[Sample] = []
        self.calls = 0
        self.goals = 0
        self.messages: Counter[str] = Counter()
        self.faults: Counter[str] = Counter()
        self._simulator = simulator
        self._agent = agent
        self._length = length
        self._rng = random.Random(seed)
        self._client = Client(domain)
        self._duplicates = DuplicateAnswers()
        self._traffic = Traffic(self._client, self._duplicates, itertools.count(1))
        self._begin = time.monotonic()
        self._next_faults = self._shuffled_faults()
        self._subscriptions = [self._subscribe(topic) for topic in TOPICS]
        # it reads the last known values, which other topics do not
        self._client.node.create_subscription(
            DiagnosticArray, "/diagnostics", partial(self._count_message, "/diagnostics"), 10
        )

    def close(self) -> None:
        self._client.close()

    def run(self) -> None:
        """Run traffic and faults, with samples at rest from time to time and at the end."""
        length = self._length
        limits = {"requests": 0, "goals": 0, "pushes": 0}
        left = length.seconds
        while left > 0:
            # no short piece at the end
            seconds = length.reference_after if left >= 2 * length.reference_after else left
            if not self.rests:
                seconds = min(length.reference_after, left)
            self._work(seconds)
            self.rests.append(self._rest(limits))
            limits = self.rests[0].held
            left -= seconds

    @property
    def duplicate_answers(self) -> list[str]:
        """Calls that were answered more than once."""
        return self._duplicates.found

    def _rest(self, limits: dict[str, int]) -> Sample:
        """Wait until the agent is at rest and return a sample.

        Args:
            limits: numbers that the agent must be back within before the timeout.
        """
        timeout = self._length.rest_timeout
        self._simulator.clear_faults()
        self._push_scene(0)  # the size of the last one must not count
        wait_until(
            lambda: self._client.call(Twist, "robot/Twist", arg=TwistMsg()).ok, "a stop", timeout
        )
        for goal in self._traffic.open_goals:
            self._traffic.cancel_goal(goal)
        self._wait_done()
        deadline = time.monotonic() + timeout
        while not _within((sample := self._sample()).held, limits):
            if time.monotonic() > deadline:
                break  # the table shows what has not come down
            threading.Event().wait(0.2)
        samples = [sample]
        while len(samples) < self._length.samples_at_rest:
            threading.Event().wait(1.0)
            samples.append(self._sample())
        return Sample(
            samples[-1].time,
            int(statistics.median(each.rss for each in samples)),
            {
                name: int(statistics.median(each.held[name] for each in samples))
                for name in sample.held
            },
        )

    def _work(self, seconds: float) -> None:
        """Run traffic and faults for some time."""
        begin = time.monotonic()
        names, weights = list(REQUEST_WEIGHTS), list(REQUEST_WEIGHTS.values())
        fault_due = begin + self._length.fault_every / 2
        sample_due = begin
        large_due = begin + LARGE_PUSH_PERIOD
        while (now := time.monotonic()) < begin + seconds:
            if now >= fault_due:
                fault_due = now + self._length.fault_every
                self._inject_fault()
            if now >= large_due:
                large_due = now + LARGE_PUSH_PERIOD
                self._replace_subscription()
                self._push_scene(self._rng.uniform(*LARGE_PUSHES))
            if now >= sample_due:
                sample_due = now + self._length.sample_every
                self.samples.append(self._sample())
                self._forget_done()
            getattr(self._traffic, self._rng.choices(names, weights)[0])(self._rng)
            threading.Event().wait(REQUEST_PERIOD)

    def _push_scene(self, size: float) -> None:
        """Push a Scene with a text of `size` MiB."""
        self._simulator.push(Scene(map_name="x" * int(size * MIB)))

    def _subscribe(self, topic: Topic) -> Any:
        return self._client.node.create_subscription(
            class_of(topic.msg, "msg"),
            self._client.path(topic.name),
            partial(self._count_message, topic.name),
            latched(topic.depth),
        )

    def _replace_subscription(self) -> None:
        """Let one of the subscribers go, and another one come."""
        index = self._rng.randrange(len(TOPICS))

        def replace() -> None:
            self._client.node.destroy_subscription(self._subscriptions[index])
            self._subscriptions[index] = self._subscribe(TOPICS[index])

        self._client.executor.create_task(replace)

    def _inject_fault(self) -> None:
        name = next(self._next_faults)
        arguments = dict(FAULT_ARGUMENTS.get(name, {}))
        if FAULTS[name].lasting:
            arguments["for_"] = min(FAULT_DURATION, self._length.fault_every / 2) * SPEED
        self._simulator.inject(name, **arguments)
        self.faults[name] += 1

    def _shuffled_faults(self) -> Iterator[str]:
        while True:
            names = list(FAULTS)
            self._rng.shuffle(names)
            yield from names

    def _sample(self) -> Sample:
        return Sample(time.monotonic() - self._begin, self._agent.rss, self._agent.held())

    def _forget_done(self) -> None:
        """Count the calls and goals that are done, and forget them."""
        traffic = self._traffic
        calls, goals = traffic.open_calls, traffic.open_goals
        self.calls += len(traffic.calls) - len(calls)
        self.goals += len(traffic.goals) - len(goals)
        traffic.calls, traffic.goals = calls, goals

    def _wait_done(self) -> None:
        """Wait until every call is answered and every goal has ended.

        A goal that still runs is cancelled again, because a fault may have lost the cancel.
        """
        deadline = time.monotonic() + self._length.rest_timeout
        while self._traffic.open_calls or self._traffic.open_goals:
            if time.monotonic() > deadline:
                left = [each.name for each in self._traffic.open_calls + self._traffic.open_goals]
                raise AssertionError(f"still open after {self._length.rest_timeout:g} s: {left}")
            threading.Event().wait(0.5)
            for goal in self._traffic.open_goals:
                self._traffic.cancel_goal(goal)
        self._forget_done()

    def _count_message(self, topic: str, _message: Any) -> None:
        self.messages[topic] += 1


def run(length: Length, seed: int = 0) -> tuple[Soak, list[Figure]]:
    """Soak an agent; return the run and the figures."""
    with (
        own_domain() as domain,
        SimulatorThread(quick_config(port=0, tcp_port=0, speed=SPEED, seed=1)) as simulator,
        connected_agent(domain, simulator, **PARAMETERS) as agent,
        contextlib.closing(Soak(domain, simulator, agent, length, seed)) as soak,
    ):
        soak.run()
        counters = agent.debug()["counters"]
    # a fault that the robot reports is logged as an error, but it is none of the agent
    own = [line for line in agent.lines if "the robot reports " not in line]
    errors = [line for line in own if "[ERROR]" in line or "Traceback" in line]
    reference, end = soak.rests[0], soak.rests[-1]
    growth = end.rss / reference.rss
    figures = [
        Figure(
            "Traffic",
            "calls answered, each once",
            str(soak.calls),
            "all",
            not soak.duplicate_answers,
        ),
        Figure("Traffic", "goals ended", str(soak.goals), "all"),
        Figure("Traffic", "messages on topics", str(soak.messages.total())),
        Figure("Traffic", "faults", f"{soak.faults.total()} of {len(soak.faults)} kinds"),
        Figure(
            "Agent", "counters", ", ".join(f"{name} {_total(counters[name])}" for name in _COUNTERS)
        ),
        Figure("Agent", "errors in its log", str(len(errors)), "0", not errors),
        Figure(
            "Memory",
            f"at rest, {end.time:.0f} s after the start",
            f"{end.rss / MIB:.1f} MiB, {growth:.3f} times the {reference.rss / MIB:.1f} MiB "
            f"at {reference.time:.0f} s",
            f"{length.max_growth} times",
            growth <= length.max_growth,
            depends_on_machine=True,
        ),
        *(
            Figure(
                "Held at rest",
                name,
                f"{end.held[name]}, {count} at {reference.time:.0f} s",
                "no growth",
                end.held[name] <= count,
            )
            for name, count in reference.held.items()
        ),
    ]
    return soak, figures


def main(arguments: Sequence[str]) -> int:
    """Soak, and print the tables.

    Returns:
        The exit status: 1 if a limit was exceeded, otherwise 0.
    """
    defaults = Length()
    parser = argparse.ArgumentParser(
        prog="scripts/bench --soak",
        description="Runs mixed traffic with faults. The exit status is 1 if a limit is exceeded.",
    )
    parser.add_argument(
        "--seconds", type=float, default=defaults.seconds, help="duration (default 3600)"
    )
    parser.add_argument(
        "--fault-every",
        type=float,
        default=defaults.fault_every,
        help="seconds from one fault to the next (default 30)",
    )
    parser.add_argument(
        "--reference-after",
        type=float,
        help="seconds until the reference memory is measured, and between two samples at rest "
        "(default 300, at most half of the duration)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of traffic and faults (default 0)"
    )
    options = parser.parse_args(arguments)
    reference = options.reference_after or min(defaults.reference_after, options.seconds / 2)
    soak, figures = run(Length(options.seconds, options.fault_every, reference), options.seed)
    print("Under load:", _samples_table(soak.samples), sep="\n\n", end="\n\n")
    print("At rest:", _samples_table(soak.rests), sep="\n\n", end="\n\n")
    return print_and_judge(figures)


def _samples_table(samples: Sequence[Sample]) -> str:
    """Return a table of about 30 evenly spread samples."""
    names = tuple(samples[0].held)
    return markdown(
        ("s", "MiB", *names),
        (
            (f"{each.time:.0f}", f"{each.rss / MIB:.1f}", *(each.held[name] for name in names))
            for each in samples[:: max(1, len(samples) // 30)]
        ),
        align="r" * (2 + len(names)),
    )


def _within(held: dict[str, int], limits: dict[str, int]) -> bool:
    return all(held[name] <= limit for name, limit in limits.items())


def _total(counter: Any) -> int:
    return sum(counter.values()) if isinstance(counter, dict) else counter
