"""`scripts/bench --soak`: mixed traffic and a fault every now and then, for an hour.

The agent is a process of its own. What it holds is compared at rest, once after a while and once
at the end: traffic stopped, faults over, everything answered and every goal ended. So nothing that
is under way is taken for growth. At work it is sampled too, for the table.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import random
import statistics
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from benchmarks.process import MIB, AgentProcess, connected_agent
from benchmarks.table import Figure, markdown
from tests.harness import Client, own_domain, wait_until
from tests.robustness.traffic import Surplus, Traffic
from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.ros_types import class_of
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread
from woosh_robot_agent.simulator.faults import FAULTS
from woosh_robot_agent.topics import latched
from woosh_robot_msgs.msg import Twist as TwistMsg
from woosh_robot_msgs.srv import Twist

SPEED = 20
"""How much faster than real time the chassis lives."""
PARAMETERS: dict[str, Any] = {
    "poll_timeout": 3000,
    "liveness_timeout": 4.0,
    "backoff_max": 1.0,
    "goal_link_timeout": 2.0,
    "result_timeout": 5,
}
"""The agent's parameters: as usual, but in more haste, so that faults of seconds have an effect."""
ACTS = {
    "query": 10,
    "twist": 6,
    "speak": 4,
    "set_sound": 1,
    "task": 1,
    "step": 1,
    "lift": 1,
    "cancel": 1,
}
"""What the user does, and how often as compared with the rest."""
PERIOD = 0.1
"""s between two things that the user does."""
ARGUMENTS: dict[str, dict[str, Any]] = {
    "oversize": {"count": 1},
    "truncated": {"where": "wire", "count": 1},
    "burst": {"count": 5000},
}
"""Arguments of faults, where the defaults would not do for a soak."""
FAULT_LASTS = 5.0
"""Longest that a fault lasts, s of real time."""
REST = 60.0
"""s in which the agent must come to rest once the traffic has stopped."""
_SAMPLES_AT_REST = 7
_COUNTERS = ("connects", "rx", "tx", "bad_frames", "dropped_pushes", "timeouts", "late_answers")
_HELD = ("tasks", "futures", "pushes", "goals", "fds", "sockets", "threads")


@dataclass(frozen=True)
class Length:
    """How long, and how hard.

    Attributes:
        seconds: how long the traffic goes on, of real time.
        fault_every: s from one fault to the next.
        reference_after: s after which the memory is taken that the end is compared with.
        sample_every: s from one sample to the next.
        most_growth: times that memory which may be held at the end.
    """

    seconds: float = 3600.0
    fault_every: float = 30.0
    reference_after: float = 300.0
    sample_every: float = 10.0
    most_growth: float = 1.05


@dataclass(frozen=True)
class Holding:
    """What the agent holds at one time.

    Attributes:
        at: s since the start.
        rss: resident memory in bytes.
        held: the number of each of tasks, futures, pushes, goals, files, sockets and threads.
    """

    at: float
    rss: int
    held: dict[str, int]


class Soak:
    """One run.

    Attributes:
        holdings: all samples, those at work.
    """

    def __init__(
        self, domain: int, simulator: SimulatorThread, agent: AgentProcess, seed: int
    ) -> None:
        self.simulator = simulator
        self.agent = agent
        self.holdings: list[Holding] = []
        self.calls = 0
        self.goals = 0
        self.messages: Counter[str] = Counter()
        self.faults: Counter[str] = Counter()
        self._rng = random.Random(seed)
        self._client = Client(domain)
        self._surplus = Surplus()
        self._traffic = Traffic(self._client, self._surplus, itertools.count(1))
        self._begun = time.monotonic()
        self._faults = self._all_faults()
        for topic in TOPICS:
            self._client.node.create_subscription(
                class_of(topic.msg, "msg"),
                self._client.path(topic.name),
                partial(self._heard, topic.name),
                latched(topic.depth),
            )

    def close(self) -> None:
        self._client.close()

    def run(self, length: Length) -> tuple[Holding, Holding]:
        """Make traffic and faults; returns what the agent held at rest, early and at the end."""
        self._work(min(length.reference_after, length.seconds), length)
        early = self.rest()
        self._work(length.seconds - length.reference_after, length)
        return early, self.rest(early)

    def rest(self, early: Holding | None = None) -> Holding:
        """Wait until everything has ended; what is held then, the median of several looks.

        Args:
            early: what was held at rest before; it gets time to come back to that.
        """
        self.simulator.clear_faults()
        wait_until(
            lambda: self._client.call(Twist, "robot/Twist", arg=TwistMsg()).ok, "a stop", REST
        )
        for goal in self._traffic.open_goals:
            self._traffic.cancel_goal(goal)
        self._wait_done()
        most = early.held if early else {"futures": 0, "goals": 0, "pushes": 0}
        with contextlib.suppress(AssertionError):  # it is for the table to say what is too much
            wait_until(lambda: _within(self._hold().held, most), "rest", REST)
        looks = []
        for _ in range(_SAMPLES_AT_REST):
            threading.Event().wait(1.0)
            looks.append(self._hold())
        return Holding(
            looks[-1].at,
            int(statistics.median(look.rss for look in looks)),
            {name: int(statistics.median(look.held[name] for look in looks)) for name in _HELD},
        )

    @property
    def answered_twice(self) -> list[str]:
        return self._surplus.found

    def _work(self, seconds: float, length: Length) -> None:
        begun = time.monotonic()
        names, weights = list(ACTS), list(ACTS.values())
        fault_due = begun + length.fault_every / 2
        sample_due = begun
        while (now := time.monotonic()) < begun + seconds:
            if now >= fault_due:
                fault_due = now + length.fault_every
                self._inject(length.fault_every)
            if now >= sample_due:
                sample_due = now + length.sample_every
                self.holdings.append(self._hold())
                self._forget()
            getattr(self._traffic, self._rng.choices(names, weights)[0])(self._rng)
            threading.Event().wait(PERIOD)

    def _inject(self, every: float) -> None:
        name = next(self._faults)
        arguments = dict(ARGUMENTS.get(name, {}))
        if FAULTS[name].lasting:
            arguments["for_"] = min(FAULT_LASTS, every / 2) * SPEED
        self.simulator.inject(name, **arguments)
        self.faults[name] += 1

    def _all_faults(self) -> Iterator[str]:
        while True:
            names = list(FAULTS)
            self._rng.shuffle(names)
            yield from names

    def _hold(self) -> Holding:
        sample, inside = self.agent.sample(), self.agent.look()
        held = {name: inside.get(name, getattr(sample, name, None)) for name in _HELD}
        return Holding(time.monotonic() - self._begun, sample.rss, held)

    def _forget(self) -> None:
        """What is done need not be remembered."""
        traffic = self._traffic
        calls, goals = traffic.open_calls, traffic.open_goals
        self.calls += len(traffic.calls) - len(calls)
        self.goals += len(traffic.goals) - len(goals)
        traffic.calls, traffic.goals = calls, goals

    def _wait_done(self) -> None:
        """Every call answered, every goal ended; a cancel that was lost is asked for again."""
        until = time.monotonic() + REST
        while self._traffic.open_calls or self._traffic.open_goals:
            if time.monotonic() > until:
                left = [each.what for each in self._traffic.open_calls + self._traffic.open_goals]
                raise AssertionError(f"not ended within {REST:g} s: {left}")
            threading.Event().wait(1.0)
            for goal in self._traffic.open_goals:
                self._traffic.cancel_goal(goal)
        self._forget()

    def _heard(self, name: str, _message: Any) -> None:
        self.messages[name] += 1


def run(length: Length, seed: int = 0) -> tuple[list[Holding], list[Figure]]:
    """Soak an agent; returns the samples and what was found."""
    with (
        own_domain() as domain,
        SimulatorThread(SimulatorConfig(port=0, tcp_port=0, speed=SPEED, seed=1)) as simulator,
        connected_agent(domain, simulator, **PARAMETERS) as agent,
        contextlib.closing(Soak(domain, simulator, agent, seed)) as soak,
    ):
        early, end = soak.run(length)
        stats = agent.look()["stats"]
    counted = ", ".join(f"{name} {_total(stats[name])}" for name in _COUNTERS)
    told = [line for line in agent.lines if "[ERROR]" in line or "Traceback" in line]
    ratio = end.rss / early.rss
    figures = [
        Figure(
            "Traffic", "calls answered, each once", str(soak.calls), "all", not soak.answered_twice
        ),
        Figure("Traffic", "goals ended", str(soak.goals), "all"),
        Figure("Traffic", "messages on topics", str(sum(soak.messages.values()))),
        Figure("Traffic", "faults", f"{sum(soak.faults.values())} of {len(soak.faults)} kinds"),
        Figure("Agent", "counters", counted),
        Figure("Agent", "errors in its log", str(len(told)), "0", not told),
        Figure(
            "Memory",
            f"at rest, {end.at:.0f} s after the start",
            f"{end.rss / MIB:.1f} MiB, {ratio:.3f} times the {early.rss / MIB:.1f} MiB "
            f"at {early.at:.0f} s",
            f"{length.most_growth} times",
            ratio <= length.most_growth,
        ),
        *(
            Figure(
                "Held at rest",
                name,
                f"{end.held[name]}, {early.held[name]} at {early.at:.0f} s",
                "no growth",
                end.held[name] <= early.held[name],
            )
            for name in _HELD
        ),
    ]
    return soak.holdings, figures


def main(arguments: Sequence[str]) -> int:
    """Soak, and print the tables.

    Returns:
        0, or 1 where a limit was exceeded.
    """
    usual = Length()
    parser = argparse.ArgumentParser(
        prog="scripts/bench --soak",
        description="Mixed traffic and a fault every now and then. The exit status is 1 if a "
        "limit was exceeded.",
    )
    parser.add_argument("--seconds", type=float, default=usual.seconds, help="default 3600")
    parser.add_argument("--fault-every", type=float, default=usual.fault_every, help="default 30")
    parser.add_argument(
        "--reference-after",
        type=float,
        default=None,
        help="s until the memory that the end is compared with; default 300, at most half",
    )
    parser.add_argument("--seed", type=int, default=0, help="of traffic and faults; default 0")
    options = parser.parse_args(arguments)
    reference = options.reference_after or min(usual.reference_after, options.seconds / 2)
    holdings, figures = run(Length(options.seconds, options.fault_every, reference), options.seed)
    print(_samples(holdings))
    print()
    print(markdown(figures))
    exceeded = [figure for figure in figures if not figure.kept]
    for figure in exceeded:
        print(f"exceeded: {figure.part}: {figure.name}: {figure.value}", file=sys.stderr)
    return 1 if exceeded else 0


def _samples(holdings: Sequence[Holding], rows: int = 30) -> str:
    """Some of the samples, evenly spread."""
    step = max(1, len(holdings) // rows)
    lines = [
        "| s | MiB | " + " | ".join(_HELD) + " |",
        "| ---: | ---: | " + "---: | " * len(_HELD),
    ]
    for each in holdings[::step]:
        cells = [f"{each.at:.0f}", f"{each.rss / MIB:.1f}", *(str(each.held[n]) for n in _HELD)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _within(held: dict[str, int], most: dict[str, int]) -> bool:
    return all(held[name] <= count for name, count in most.items())


def _total(counter: Any) -> int:
    return sum(counter.values()) if isinstance(counter, dict) else counter
