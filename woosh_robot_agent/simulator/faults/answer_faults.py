"""Faults of requests and answers, independent of the encoding."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Iterable

from woosh_robot_agent.simulator.faults.arguments import Argument
from woosh_robot_agent.simulator.faults.fault import End, Fault, Injection, Target
from woosh_robot_agent.simulator.serving.hooks import Outgoing, Release

_MAX_SN = 2**31 - 1

TYPE = Argument(
    "type", str, "", "affects only answers to requests of this type; empty: all", is_message=True
)
COUNT = Argument("count", int, 0, "number of times that the fault takes effect; 0: no limit", low=0)
FRAMES = Argument(
    "frames",
    str,
    "answers",
    "frames that the fault affects; for pushes, `type` is the type of the push",
    choices=("answers", "pushes", "all"),
)


def applies_to(injection: Injection, frame: Outgoing) -> bool:
    """Return True if a fault affects a frame, by its arguments `type` and `frames`."""
    frames = injection.arguments.get("frames", "answers")
    name = frame.request if frame.is_answer else frame.type
    return (
        injection.active
        and frames in ("all", "answers" if frame.is_answer else "pushes")
        and injection["type"] in ("", name)
    )


def on_frames(
    alter: Callable[[Injection, Outgoing], Iterable[Outgoing]],
) -> Callable[[Target, Injection], End]:
    """Return the `begin` function of a fault that replaces the frames that it affects."""

    def begin(target: Target, injection: Injection) -> End:
        def intercept(frame: Outgoing) -> Iterable[Outgoing]:
            if not applies_to(injection, frame):
                return [frame]
            frames = alter(injection, frame)
            injection.hit()
            return frames

        return target.hooks.add_fault(intercept)

    return begin


def _refuse(target: Target, injection: Injection) -> End:
    def refusal(type_name: str) -> str | None:
        if injection["type"] not in ("", type_name):
            return None
        injection.hit()
        text: str = injection["text"]
        return text

    return target.hooks.add_refusal(refusal)


def _delay(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
    seconds = injection["seconds"] + injection.rng.uniform(0.0, injection["jitter"])
    return [dataclasses.replace(frame, delay=frame.delay + seconds)]


def _wrong_sn(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
    return [dataclasses.replace(frame, sn=(frame.sn + injection["by"] - 1) % _MAX_SN + 1)]


def _wrong_type(injection: Injection, frame: Outgoing) -> Iterable[Outgoing]:
    return [dataclasses.replace(frame, type=injection["other"])]


class _Shuffle:
    """Collects the frames of each client up to a number or a timeout, and shuffles them."""

    def __init__(self, injection: Injection) -> None:
        self._injection = injection
        self._kept: dict[object, list[Release]] = {}
        self._timers: dict[object, asyncio.TimerHandle] = {}

    def keep(self, client: object, release: Release) -> None:
        kept = self._kept.setdefault(client, [])
        kept.append(release)
        if len(kept) >= self._injection["window"] or not self._injection.active:
            self._flush(client)
        elif client not in self._timers:
            loop = asyncio.get_running_loop()
            timer = loop.call_later(self._injection["seconds"], self._flush, client)
            self._timers[client] = timer

    def flush(self) -> None:
        for client in list(self._kept):
            self._flush(client)

    def _flush(self, client: object) -> None:
        timer = self._timers.pop(client, None)
        if timer:
            timer.cancel()
        kept = self._kept.pop(client)
        mixed = kept[:]
        self._injection.rng.shuffle(mixed)
        if mixed == kept:  # the shuffle had no effect
            mixed.reverse()
        for release in mixed:
            release()


def _reorder(target: Target, injection: Injection) -> End:
    shuffle = _Shuffle(injection)
    keep = on_frames(lambda injection, frame: [dataclasses.replace(frame, hold=shuffle.keep)])
    stop = keep(target, injection)

    def end() -> None:
        stop()
        shuffle.flush()

    return end


FAULTS = (
    Fault(
        "refuse",
        "requests are not executed, and answered with `ok` false and a text",
        _refuse,
        (
            Argument("text", str, "refused by the simulator", "text of the answers"),
            dataclasses.replace(TYPE, description="affects only requests of this type; empty: all"),
            COUNT,
        ),
    ),
    Fault(
        "delay",
        "answers are delayed; later ones may overtake them",
        on_frames(_delay),
        (
            Argument(
                "seconds", float, 1.0, "minimum delay", unit="s of real time", low=0.0, high=86400.0
            ),
            Argument(
                "jitter",
                float,
                0.0,
                "maximum of a random additional delay",
                unit="s of real time",
                low=0.0,
                high=86400.0,
            ),
            TYPE,
            COUNT,
            FRAMES,
        ),
    ),
    Fault(
        "reorder",
        "answers are collected and sent in another order",
        _reorder,
        (
            Argument("window", int, 4, "number of answers to collect", low=2, high=1000),
            Argument(
                "seconds",
                float,
                0.2,
                "maximum time to hold an answer back",
                unit="s of real time",
                low=0.0,
                high=3600.0,
            ),
            TYPE,
            COUNT,
        ),
    ),
    Fault(
        "lose_answer",
        "requests are executed, but their answers are not sent",
        on_frames(lambda injection, frame: []),
        (TYPE, COUNT),
    ),
    Fault(
        "answer_twice",
        "each answer is sent twice",
        on_frames(lambda injection, frame: [frame, frame]),
        (TYPE, COUNT),
    ),
    Fault(
        "wrong_sn",
        "the `sn` of an answer differs from that of its request",
        on_frames(_wrong_sn),
        (
            Argument(
                "by",
                int,
                1_000_000,
                "difference between the two serial numbers",
                low=1,
                high=_MAX_SN - 1,
            ),
            TYPE,
            COUNT,
        ),
    ),
    Fault(
        "wrong_type",
        "the `type` of an answer differs from that of its body",
        on_frames(_wrong_type),
        (
            Argument("other", str, "woosh.robot.Network", "wrong type of the answers"),
            TYPE,
            COUNT,
        ),
    ),
)
