"""Seeded scenarios: traffic with one fault or two, after which the agent's promises are checked.

A seed determines everything: the faults with their times and arguments, and the traffic. The first
seeds stand for each fault alone and the next ones for each pair. Further seeds repeat these
combinations at other times.
"""

from __future__ import annotations

import itertools
import random
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from benchmarks.robustness.rig import (
    BACKOFF_MAX,
    KINDS,
    MAX_FRAME_MIB,
    NEVER,
    BrokenPromiseError,
    Rig,
)
from benchmarks.robustness.traffic import Mark, Traffic, marks_of
from woosh_robot_agent.simulator.faults import FAULTS

ALONE: tuple[tuple[str, ...], ...] = tuple((name,) for name in FAULTS)
PAIRS: tuple[tuple[str, ...], ...] = tuple(itertools.combinations(FAULTS, 2))
COMBINATIONS = ALONE + PAIRS
BLOCK = 23
"""Number of consecutive scenarios that share one agent, one chassis and one client."""
BACK_WITHIN = 2.0 + BACKOFF_MAX
"""Time after the end of the faults within which a command must succeed again, in seconds."""
_AT_FAULT = ("speak", "speak", "query", "twist", "task", "step")
"""Requests that may be made at the beginning of a fault, as methods of `Traffic`."""
_GOALS = ("task", "step", "lift", "task_set", "lift_column", "charge", "navigation_mode")
"""Goals that may be sent at any time, as methods of `Traffic`."""
_LAST = 1_000_000
"""Rank of an event that is handled after all others due at the same time."""
_GOAL_TIME = 1.0
"""Time after the faults when the client cancels goals that still run, in seconds."""
_REQUEST_TYPES = (
    "woosh.robot.RobotInfo",
    "woosh.robot.Speak",
    "woosh.robot.Twist",
    "woosh.robot.ExecTask",
    "woosh.robot.TaskProc",
    "woosh.robot.ActionOrder",
    "woosh.ros.CallAction",
    "woosh.ros.Feedbacks",
)


def _any_answers(rng: random.Random) -> dict[str, Any]:
    """Draw which answers a fault affects: of all types or one, a number of them or all."""
    arguments: dict[str, Any] = {}
    if rng.random() < 0.5:
        arguments["type"] = rng.choice(_REQUEST_TYPES)
    if rng.random() < 0.5:
        arguments["count"] = rng.randint(1, 5)
    return arguments


def _any_frames(rng: random.Random) -> dict[str, Any]:
    """Draw which frames a fault affects: some answers, the pushes, or all frames."""
    frames = rng.choice(("answers", "answers", "pushes", "all"))
    return {"frames": frames, **(_any_answers(rng) if frames == "answers" else {})}


def _any_truncated(rng: random.Random) -> dict[str, Any]:
    if rng.random() < 0.5:
        return {"where": "payload", **_any_frames(rng)}
    return {"where": "wire", "count": 1, "frames": rng.choice(("answers", "pushes"))}


_ARGUMENTS: dict[str, Callable[[random.Random], dict[str, Any]]] = {
    "refuse": lambda rng: {"text": f"refused {rng.random()}", **_any_answers(rng)},
    "delay": lambda rng: {
        "seconds": rng.uniform(0.01, 0.6),
        "jitter": rng.uniform(0.0, 0.3),
        **_any_frames(rng),
    },
    "reorder": lambda rng: {"window": rng.randint(2, 8), **_any_answers(rng)},
    "lose_answer": _any_answers,
    "answer_twice": _any_answers,
    "wrong_sn": lambda rng: {"by": rng.choice((1, 2, 1_000_000)), **_any_answers(rng)},
    "wrong_type": _any_answers,
    "garbage": lambda rng: {"length": rng.choice((1, 64, 4096)), **_any_frames(rng)},
    "truncated": _any_truncated,
    "oversize": lambda rng: {**_any_frames(rng), "mib": MAX_FRAME_MIB + 1, "count": 2},
    "invalid_utf8": _any_frames,
    "unknown_fields": _any_frames,
    "wrong_field_type": _any_frames,
    "obstacle": lambda rng: {"ahead": rng.uniform(0.6, 2.0), "radius": rng.uniform(0.1, 0.4)},
    "burst": lambda rng: {"count": rng.randint(100, 3000)},
}
"""Functions that draw the arguments of a fault. Faults not listed have default arguments."""
_DURATIONS = {"half_open": (0.3, 1.5), "freeze": (0.2, 1.0), "off": (0.2, 0.8)}
"""Shortest and longest duration of some faults, in seconds."""
_DEFAULT_DURATIONS = (0.1, 0.6)
"""Shortest and longest duration of the other faults, in seconds."""
_TRIGGERS = {"accept_then_drop": "drop"}
"""Fault to inject together with a fault that affects new connections only, by the latter's name."""


@dataclass(frozen=True)
class PlannedFault:
    """One fault.

    Attributes:
        name: name of the fault.
        arguments: its arguments.
        at: time of its beginning, in seconds of real time since the start of the scenario.
        until: time of its end.
    """

    name: str
    arguments: dict[str, Any]
    at: float
    until: float


@dataclass(frozen=True)
class Plan:
    """The scenario of a seed.

    Attributes:
        seed: the seed.
        kind: settings of the agent.
        faults: one fault or two.
        requests: times of the user's requests, and their names as methods of `Traffic`.
    """

    seed: int
    kind: dict[str, str]
    faults: tuple[PlannedFault, ...]
    requests: tuple[tuple[float, str], ...]


@dataclass
class Outcome:
    """Result of a scenario.

    Attributes:
        seed: seed of the scenario.
        faults: names of its faults.
        calls: number of calls.
        answered_once: number of calls that got exactly one answer.
        goals: number of goals.
        goals_ended: number of goals that ended.
        recovery: time from the end of the faults to the first command that succeeded, in seconds.
        violations: broken promises.
    """

    seed: int
    faults: tuple[str, ...]
    calls: int = 0
    answered_once: int = 0
    goals: int = 0
    goals_ended: int = 0
    recovery: float = 0.0
    violations: list[str] = field(default_factory=list)


def plan(seed: int) -> Plan:
    """Return the scenario of a seed."""
    rng = random.Random(seed)
    length = rng.uniform(0.5, 0.9)
    faults = []
    for name in COMBINATIONS[seed % len(COMBINATIONS)]:
        at = rng.uniform(0.05, 0.6) * length
        lasts = rng.uniform(*_DURATIONS.get(name, _DEFAULT_DURATIONS))
        arguments = _ARGUMENTS.get(name, lambda _rng: {})(rng)
        faults.append(PlannedFault(name, arguments, at, at + lasts))
    last = max(faults, key=lambda fault: fault.until)
    length = max(length, last.until)
    # the last fault lasts until the end of the scenario
    faults[faults.index(last)] = replace(last, until=length)
    requests = [
        (
            rng.uniform(0, length),
            rng.choice(("query", "query", "speak", "speak", "light", "set_sound")),
        )
        for _ in range(rng.randint(10, 25))
    ]
    if rng.random() < 0.6:
        begin, period = rng.uniform(0, length / 2), rng.uniform(0.02, 0.08)
        requests += [(begin + i * period, "twist") for i in range(rng.randint(5, 15))]
    for name in _GOALS:
        if rng.random() < 0.4:
            requests += [(rng.uniform(0, length), name) for _ in range(rng.randint(1, 2))]
    for fault in faults:  # a fault has little effect if nothing is in flight
        requests += [(fault.at, name) for name in rng.choices(_AT_FAULT, k=rng.randint(1, 6))]
    requests += [(rng.uniform(0, length), "cancel") for _ in range(rng.randint(0, 2))]
    kind = KINDS[seed // BLOCK % len(KINDS)]
    return Plan(seed, kind, tuple(faults), tuple(sorted(requests)))


def run(rig: Rig, scenario: Plan, back_within: float = BACK_WITHIN) -> Outcome:
    """Run a scenario and check the agent's promises.

    Args:
        rig: a rig with the settings of the scenario.
        scenario: the scenario.
        back_within: time within which the agent must be back in service, in seconds.
    """
    outcome = Outcome(scenario.seed, tuple(fault.name for fault in scenario.faults))
    traffic = rig.traffic()
    try:
        _play(rig, scenario, traffic, outcome, back_within)
    except (BrokenPromiseError, AssertionError) as error:
        outcome.violations.append(str(error))
    outcome.violations += [f"error in the log: {text}" for text in rig.take_errors()]
    return outcome


def _play(rig: Rig, scenario: Plan, traffic: Traffic, outcome: Outcome, back_within: float) -> None:
    first_text = _until_served(traffic)[0]
    rig.check_footprint()
    rng = random.Random(scenario.seed)
    _play_timeline(rig, scenario, traffic, rng)
    rig.simulator.clear_faults()
    _, outcome.recovery = _until_served(traffic)
    if outcome.recovery > back_within:
        outcome.violations.append(f"back in service only after {outcome.recovery:.2f} s")

    _wait(lambda: not traffic.open_calls)
    twists = rig.sent_twists  # every call is answered, so no velocity may be sent from now on
    outcome.calls = len(traffic.calls)
    outcome.violations += [f"never answered: {call.name}" for call in traffic.open_calls]
    duplicates, rig.duplicates.found = rig.duplicates.found, []
    outcome.violations += [f"answered twice: {call}" for call in duplicates]
    outcome.answered_once = outcome.calls - len(traffic.open_calls) - len(duplicates)

    _wait(lambda: not traffic.open_goals, _GOAL_TIME)
    for goal in traffic.open_goals:
        traffic.cancel_goal(goal)
    _wait(lambda: not traffic.open_goals)
    outcome.goals = len(traffic.goals)
    outcome.goals_ended = outcome.goals - len(traffic.open_goals)
    outcome.violations += [f"never ended: {goal.name}" for goal in traffic.open_goals]
    outcome.violations += [f"{goal.name}: {goal.error}" for goal in traffic.goals if goal.error]

    if not _wait(lambda: not rig.in_flight()):
        outcome.violations.append(f"still in flight in the agent: {rig.in_flight()}")
    rig.check_alive()
    outcome.violations += _replays(rig, traffic, first_text)
    _settle_chassis(rig)
    rig.check_footprint()
    if rig.sent_twists != twists:
        outcome.violations.append("a velocity command was sent after every call had been answered")


def _play_timeline(rig: Rig, scenario: Plan, traffic: Traffic, rng: random.Random) -> None:
    """Make requests and faults at their times."""
    events: list[tuple[float, int, Callable[[], Any]]] = []
    for fault in scenario.faults:
        injected: list[Callable[[], Any]] = []

        def inject(fault: PlannedFault = fault, injected: list[Any] = injected) -> None:
            injected.append(rig.simulator.inject(fault.name, **fault.arguments).clear)
            if fault.name in _TRIGGERS:
                rig.simulator.inject(_TRIGGERS[fault.name])

        events.append((fault.at, _LAST, inject))
        events.append((fault.until, _LAST, lambda injected=injected: injected.pop()()))
    for number, (at, name) in enumerate(scenario.requests):
        events.append((at, number, lambda name=name: getattr(traffic, name)(rng)))
    begin = time.monotonic()
    for at, _, event in sorted(events, key=lambda each: each[:2]):
        time.sleep(max(0.0, begin + at - time.monotonic()))
        event()


def _until_served(traffic: Traffic) -> tuple[str, float]:
    """Repeat a command until it succeeds; return its text, and the time it took in seconds."""
    begin = time.monotonic()
    while True:
        call = traffic.speak()
        if not _wait(call.future.done):
            raise BrokenPromiseError(f"never answered: {call.name}")
        duration = time.monotonic() - begin
        if call.future.result().ok:
            return call.name.split(" ", 1)[1], duration
        if duration > NEVER:
            raise BrokenPromiseError(f"not back in service: {call.future.result().msg}")
        time.sleep(0.02)


def _wait(condition: Callable[[], Any], timeout: float = NEVER) -> bool:
    """Wait for a condition; return False if it does not come true in time."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True


def _replays(rig: Rig, traffic: Traffic, first_text: str) -> list[str]:
    """Return a violation for each command that the chassis received more often than allowed.

    Args:
        rig: the rig.
        traffic: the traffic of the scenario.
        first_text: text that the robot was told to say at the start of the scenario.
    """
    got: Counter[Mark] = Counter()
    for each in reversed(rig.simulator.received):
        marks = marks_of(each.message)
        got.update(marks)
        if marks == [("Speak", first_text)]:
            break
    else:
        return ["the chassis's record does not reach back to the start of the scenario"]
    return [
        f"the chassis got {mark} {count} times instead of {traffic.allowed[mark]}"
        for mark, count in got.items()
        if count > traffic.allowed[mark]
    ]


def _settle_chassis(rig: Rig) -> None:
    """End the robot's tasks and actions, such as a goal that the agent has given up."""

    def settle(simulator: Any) -> bool:
        chassis = simulator.chassis
        if chassis.tasks.active:
            chassis.tasks.cancel("the scenario is over")
        chassis.actions.fail_all("the scenario is over")
        return not chassis.tasks.active

    if not _wait(lambda: rig.simulator.call(settle)):
        raise BrokenPromiseError("the chassis does not come to rest")
