"""Seeded scenarios: traffic, one fault or two in the middle of it, and then the promises checked.

A seed says everything: which faults, when and how, and what the user does meanwhile. The first
seeds take each fault alone, the next ones each pair, and so on round again with other moments.
"""

from __future__ import annotations

import itertools
import random
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from tests.robustness.rig import BACKOFF_MAX, GIVE_UP, KINDS, MAX_FRAME_MIB, Rig, Trouble
from tests.robustness.traffic import Mark, Traffic, marks_of
from woosh_robot_agent.simulator.faults import FAULTS

ALONE: tuple[tuple[str, ...], ...] = tuple((name,) for name in FAULTS)
PAIRS: tuple[tuple[str, ...], ...] = tuple(itertools.combinations(FAULTS, 2))
COMBINATIONS = ALONE + PAIRS
BLOCK = 23
"""Scenarios in a row that share one agent, one chassis and one client."""
BACK_WITHIN = 2.0 + BACKOFF_MAX
"""s after the chassis's return within which a command must succeed again."""
_VOLLEY = ("speak", "speak", "query", "twist", "task", "step")
_LAST = 1_000_000
"""Comes after everything else that is due at the same time."""
_ENDS_BY_ITSELF = 1.0
"""s that goals get after the faults before their client cancels them."""
_REQUESTS = (
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
    """Which answers a fault of the answers hits: all, or those to one type; some, or no end."""
    arguments: dict[str, Any] = {}
    if rng.random() < 0.5:
        arguments["type"] = rng.choice(_REQUESTS)
    if rng.random() < 0.5:
        arguments["count"] = rng.randint(1, 5)
    return arguments


def _any_frames(rng: random.Random) -> dict[str, Any]:
    """As `_any_answers`, or pushes, or everything that the chassis says."""
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
"""How the arguments of a fault are drawn; its defaults where it is not named."""
_LENGTHS = {"half_open": (0.3, 1.5), "freeze": (0.2, 1.0), "off": (0.2, 0.8)}
"""Shortest and longest duration of a lasting fault, s, where it is not the usual one."""
_USUAL_LENGTH = (0.1, 0.6)
_SHOWN_BY = {"accept_then_drop": "drop"}
"""What has to happen too for a fault to show: this one meets new connections only."""


@dataclass(frozen=True)
class PlannedFault:
    """One fault: s of real time from the scenario's start."""

    name: str
    arguments: dict[str, Any]
    at: float
    until: float


@dataclass(frozen=True)
class Plan:
    """What a seed stands for.

    Attributes:
        seed: the seed.
        kind: the agent's set-up.
        faults: one or two.
        acts: what the user does, as names of methods of `Traffic`, and when.
    """

    seed: int
    kind: dict[str, str]
    faults: tuple[PlannedFault, ...]
    acts: tuple[tuple[float, str], ...]

    @property
    def title(self) -> str:
        return " + ".join(fault.name for fault in self.faults)


@dataclass
class Outcome:
    """What became of a scenario.

    Attributes:
        recovery: s from the chassis's return to the first command that succeeded.
        violations: promises that were broken.
        clean: whether the next scenario can go on with the same rig.
    """

    seed: int
    faults: tuple[str, ...]
    calls: int = 0
    answered_once: int = 0
    goals: int = 0
    goals_ended: int = 0
    recovery: float = 0.0
    violations: list[str] = field(default_factory=list)
    clean: bool = True


def plan(seed: int) -> Plan:
    """The scenario of a seed."""
    rng = random.Random(seed)
    length = rng.uniform(0.5, 0.9)
    faults = []
    for name in COMBINATIONS[seed % len(COMBINATIONS)]:
        at = rng.uniform(0.05, 0.6) * length
        lasts = rng.uniform(*_LENGTHS.get(name, _USUAL_LENGTH))
        arguments = _ARGUMENTS.get(name, lambda _rng: {})(rng)
        faults.append(PlannedFault(name, arguments, at, at + lasts))
    last = max(faults, key=lambda fault: fault.until)
    length = max(length, last.until)
    faults[faults.index(last)] = replace(last, until=length)  # the end: the chassis is back
    acts = [
        (rng.uniform(0, length), rng.choice(("query", "query", "speak", "speak", "set_sound")))
        for _ in range(rng.randint(10, 25))
    ]
    if rng.random() < 0.6:
        begin, period = rng.uniform(0, length / 2), rng.uniform(0.02, 0.08)
        acts += [(begin + i * period, "twist") for i in range(rng.randint(5, 15))]
    for act in ("task", "step", "lift"):
        if rng.random() < 0.5:
            acts += [(rng.uniform(0, length), act) for _ in range(rng.randint(1, 2))]
    for fault in faults:  # a fault that meets nothing under way shows little
        acts += [(fault.at, act) for act in rng.choices(_VOLLEY, k=rng.randint(1, 6))]
    acts += [(rng.uniform(0, length), "cancel") for _ in range(rng.randint(0, 2))]
    kind = KINDS[seed // BLOCK % len(KINDS)]
    return Plan(seed, kind, tuple(faults), tuple(sorted(acts)))


def run(rig: Rig, what: Plan, back_within: float = BACK_WITHIN) -> Outcome:
    """Play a scenario and check what the agent promises.

    Args:
        rig: of the plan's kind.
        what: the scenario.
        back_within: s within which the agent must be back in service.
    """
    outcome = Outcome(what.seed, tuple(fault.name for fault in what.faults))
    traffic = rig.traffic()
    try:
        _play(rig, what, traffic, outcome, back_within)
    except (Trouble, AssertionError) as trouble:
        outcome.violations.append(str(trouble))
    outcome.violations += [f"error in the log: {text}" for text in rig.errors]
    outcome.clean = not outcome.violations
    return outcome


def _play(rig: Rig, what: Plan, traffic: Traffic, outcome: Outcome, back_within: float) -> None:
    begin = _until_served(rig, traffic)[0]
    rig.check_footprint()
    rng = random.Random(what.seed)
    _timeline(rig, what, traffic, rng)
    rig.simulator.clear_faults()
    _, outcome.recovery = _until_served(rig, traffic)
    if outcome.recovery > back_within:
        outcome.violations.append(f"back in service only after {outcome.recovery:.2f} s")

    _wait(lambda: not traffic.open_calls)
    twists = rig.sent_twists  # those who asked have their answers: from now on none may be sent
    outcome.calls = len(traffic.calls)
    outcome.violations += [f"never answered: {call.what}" for call in traffic.open_calls]
    surplus, rig.surplus.found = rig.surplus.found, []
    outcome.violations += [f"answered twice: {what}" for what in surplus]
    outcome.answered_once = outcome.calls - len(traffic.open_calls) - len(surplus)

    _wait(lambda: not traffic.open_goals, _ENDS_BY_ITSELF)
    for goal in traffic.open_goals:
        traffic.cancel_goal(goal)
    _wait(lambda: not traffic.open_goals)
    outcome.goals = len(traffic.goals)
    outcome.goals_ended = outcome.goals - len(traffic.open_goals)
    outcome.violations += [f"never ended: {goal.what}" for goal in traffic.open_goals]
    outcome.violations += [f"{goal.what}: {goal.error}" for goal in traffic.goals if goal.error]

    _wait(lambda: not rig.at_rest())
    if held := rig.at_rest():
        outcome.violations.append(f"the agent still holds {held}")
    rig.alive()
    outcome.violations += _replays(rig, traffic, begin)
    _settle_chassis(rig)
    rig.check_footprint()
    if rig.sent_twists != twists:
        outcome.violations.append("a velocity command was sent after everybody had his answer")


def _timeline(rig: Rig, what: Plan, traffic: Traffic, rng: random.Random) -> None:
    """Let everything happen when it is due."""
    events: list[tuple[float, int, Callable[[], Any]]] = []
    for fault in what.faults:
        cleared: list[Callable[[], Any]] = []

        def inject(fault: PlannedFault = fault, cleared: list[Any] = cleared) -> None:
            cleared.append(rig.simulator.inject(fault.name, **fault.arguments).clear)
            if fault.name in _SHOWN_BY:
                rig.simulator.inject(_SHOWN_BY[fault.name])

        events.append((fault.at, _LAST, inject))
        events.append((fault.until, _LAST, lambda cleared=cleared: cleared.pop()()))
    for number, (at, act) in enumerate(what.acts):
        events.append((at, number, lambda act=act: getattr(traffic, act)(rng)))
    begun = time.monotonic()
    for at, _, happen in sorted(events, key=lambda event: event[:2]):
        time.sleep(max(0.0, begun + at - time.monotonic()))
        happen()


def _until_served(rig: Rig, traffic: Traffic) -> tuple[str, float]:
    """Ask until a command succeeds; returns its text, and the s that it took."""
    begun = time.monotonic()
    while True:
        call = traffic.speak()
        if not _wait(call.future.done):
            raise Trouble(f"never answered: {call.what}")
        taken = time.monotonic() - begun
        if call.future.result().ok:
            return call.what.split(" ", 1)[1], taken
        if taken > GIVE_UP:
            raise Trouble(f"not back in service: {call.future.result().msg}")
        time.sleep(0.02)


def _wait(condition: Callable[[], Any], timeout: float = GIVE_UP) -> bool:
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True


def _replays(rig: Rig, traffic: Traffic, begin: str) -> list[str]:
    """What the chassis got that nobody asked for, or got more often than it was asked."""
    got: Counter[Mark] = Counter()
    for each in reversed(rig.simulator.received):
        marks = marks_of(each.message)
        got.update(marks)
        if marks == [("Speak", begin)]:
            break
    else:
        return ["the chassis does not know the beginning of the scenario any more"]
    return [
        f"the chassis got {mark} {count} times, and should {traffic.asked[mark]} times"
        for mark, count in got.items()
        if count > traffic.asked[mark]
    ]


def _settle_chassis(rig: Rig) -> None:
    """End what the robot still does by itself: a goal that was given up with the link, say."""

    def settle(simulator: Any) -> bool:
        chassis = simulator.chassis
        if chassis.tasks.active:
            chassis.tasks.cancel("the scenario is over")
        chassis.actions.abort("the scenario is over")
        return not chassis.tasks.active

    if not _wait(lambda: rig.simulator.call(settle)):
        raise Trouble("the chassis does not come to rest")
