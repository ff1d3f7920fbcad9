"""Frames, bytes and requests that make no sense: nothing breaks, hangs, or forgets to go on.

scripts/bench --fuzz                            a million inputs
scripts/bench --fuzz --inputs 20000 --seed 7    fewer, other ones
scripts/bench --fuzz --target json --first 1234 --inputs 1 --seed 7    one of them again
"""

from __future__ import annotations

import argparse
import logging
import random
import resource
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from tests.robustness.fuzz_targets import ACCEPTED, TARGETS, Target, batches

HANG = 120
"""s after which a portion of inputs counts as hanging."""
_MOST_MEMORY_MB = 1000
"""By how much the process may grow over all inputs of one target."""
_CRASHES_SHOWN = 5
_INPUT_SHOWN = 4000
_LINES_SHOWN = 40


class Hang(Exception):
    """An input took too long."""


@dataclass
class Result:
    """What became of a target's inputs.

    Attributes:
        name: of the target.
        inputs: how many it took.
        kinds: how many were accepted, and refused of each kind.
        crashes: texts to find and repeat each by.
        seconds: that it took, the making of the inputs included.
        slowest: s of the slowest input, of the slowest portion's mean where it takes several.
        memory: MB by which the process grew.
    """

    name: str
    inputs: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    crashes: list[str] = field(default_factory=list)
    seconds: float = 0.0
    slowest: float = 0.0
    memory: float = 0.0


def fuzz(key: str, count: int, seed: int, first: int = 0) -> Result:
    """Feed one target.

    Args:
        key: which one, of `TARGETS`.
        count: how many inputs.
        seed: of the inputs.
        first: number of the first one.
    """
    target = TARGETS[key]()
    result = Result(target.name)
    begun, memory = time.monotonic(), _memory()
    before = signal.signal(signal.SIGALRM, _hang)
    try:
        for number, batch in batches(target, seed, count, first):
            started = time.monotonic()
            signal.alarm(HANG)
            try:
                result.kinds += target.feed(batch)
            except Exception:
                told = _told(key, seed, number, batch, traceback.format_exc())
                result.crashes.append(told)
                target = _anew(target)
            finally:
                signal.alarm(0)
            result.inputs += len(batch)
            result.slowest = max(result.slowest, (time.monotonic() - started) / len(batch))
    finally:
        signal.signal(signal.SIGALRM, before)
        target.close()
    result.seconds = time.monotonic() - begun
    result.memory = _memory() - memory
    if result.memory > _MOST_MEMORY_MB:
        result.crashes.append(f"{key}: the process grew by {result.memory:.0f} MB")
    return result


def _hang(*_: object) -> None:
    raise Hang(f"more than {HANG} s")


def _anew(target: Target) -> Target:
    """A target in place of one that has crashed."""
    try:
        target.close()
    except Exception:
        traceback.print_exc()
    return type(target)()


def _told(key: str, seed: int, number: int, batch: Sequence[Any], trace: str) -> str:
    again = f"--target {key} --seed {seed} --first {number} --inputs {len(batch)}"
    said = "\n".join(line[:200] for line in trace.rstrip().splitlines()[:_LINES_SHOWN])
    lines = [f"{key}: crash; again: scripts/bench --fuzz {again}", said]
    for at, data in enumerate(batch[:_CRASHES_SHOWN]):
        lines.append(f"input {number + at} = {data!r}"[:_INPUT_SHOWN])
    return "\n".join(lines)


def _memory() -> float:
    """The most that the process has held so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def table(results: Sequence[Result]) -> str:
    """All results as a Markdown table."""
    lines = [
        "| target | inputs | accepted | refused, by kind | crashes | inputs/s | slowest, ms | MB |",
        "|---|---:|---:|---|---:|---:|---:|---:|",
    ]
    for one in results:
        refused = ", ".join(
            f"{kind} {number:,}" for kind, number in one.kinds.most_common() if kind != ACCEPTED
        )
        lines.append(
            f"| {one.name} | {one.inputs:,} | {one.kinds[ACCEPTED]:,} | {refused or '-'} "
            f"| {len(one.crashes)} | {one.inputs / max(one.seconds, 1e-9):,.0f} "
            f"| {one.slowest * 1000:.0f} | {one.memory:.0f} |"
        )
    total, crashes = sum(one.inputs for one in results), sum(len(one.crashes) for one in results)
    lines.append(f"| all | {total:,} | | | {crashes} | | | |")
    return "\n".join(lines)


def main(arguments: Sequence[str]) -> int:
    """Fuzz what the arguments say, and print the table.

    Returns:
        0, or 1 if anything crashed.
    """
    parser = argparse.ArgumentParser(
        prog="scripts/bench --fuzz", description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--inputs", type=int, default=1_000_000, help="how many in all")
    parser.add_argument("--seed", type=int, help="of the inputs; a new one each time if left out")
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument(
        "--target", action="append", choices=TARGETS, help="only this one; can be repeated"
    )
    options = parser.parse_args(arguments)
    seed = random.randrange(2**32) if options.seed is None else options.seed
    keys = options.target or list(TARGETS)
    shares = sum(TARGETS[key].share for key in keys)
    print(f"seed {seed}", file=sys.stderr)
    logging.getLogger("woosh_robot_agent").setLevel(logging.ERROR)
    logging.getLogger("woosh_robot_agent").propagate = False
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # handshakes that are broken off
    results = []
    for key in keys:
        count = max(1, round(options.inputs * TARGETS[key].share / shares))
        results.append(fuzz(key, count, seed, options.first))
        for crash in results[-1].crashes[:_CRASHES_SHOWN]:
            print(crash, end="\n\n", file=sys.stderr)
        print(table(results[-1:]).splitlines()[2], file=sys.stderr)
    print(table(results))
    print(f"\nseed {seed}")
    return int(any(one.crashes for one in results))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
