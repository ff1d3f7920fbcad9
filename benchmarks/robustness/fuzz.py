"""Feed malformed frames, bytes and requests to codecs, client and simulator. None may fail.

scripts/bench --fuzz                            a million inputs
scripts/bench --fuzz --inputs 20000 --seed 7    fewer inputs, of another seed
scripts/bench --fuzz --target json --first 1234 --inputs 1 --seed 7    repeat one input
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

from benchmarks.figures import markdown
from benchmarks.robustness.fuzz_targets import ACCEPTED, TARGETS, Target, batches

HANG_TIMEOUT = 120
"""Timeout for a batch of inputs, in seconds. After it the target counts as hanging."""
_MAX_MEMORY_GROWTH = 1000
"""Maximum growth of the process over all inputs of one target, in MB."""
_MAX_CRASHES_SHOWN = 5
_MAX_INPUT_SHOWN = 4000
"""Length of an input in a report, in characters."""
_MAX_LINES_SHOWN = 40
"""Length of a traceback in a report, in lines."""


class HangError(Exception):
    """A batch of inputs exceeded its timeout."""


@dataclass
class Result:
    """Results for one target.

    Attributes:
        name: name of the target.
        inputs: number of inputs.
        kinds: number of accepted inputs, and of refused ones by kind.
        crashes: report of each crash, with the command that repeats it.
        seconds: duration, including the generation of the inputs, in seconds.
        slowest: longest time that a batch took per input, in seconds.
        memory: growth of the process, in MB.
    """

    name: str
    inputs: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    crashes: list[str] = field(default_factory=list)
    seconds: float = 0.0
    slowest: float = 0.0
    memory: float = 0.0


def fuzz(key: str, count: int, seed: int, first: int = 0) -> Result:
    """Feed inputs to one target.

    Args:
        key: key of the target in `TARGETS`.
        count: number of inputs.
        seed: seed of the inputs.
        first: number of the first input.
    """
    target = TARGETS[key]()
    result = Result(target.name)
    begin, memory = time.monotonic(), _memory()
    before = signal.signal(signal.SIGALRM, _raise_hang)
    try:
        for number, batch in batches(target, seed, count, first):
            started = time.monotonic()
            signal.alarm(HANG_TIMEOUT)
            try:
                result.kinds += target.feed(batch)
            except Exception:
                report = _report(key, seed, number, batch, traceback.format_exc())
                result.crashes.append(report)
                target = _replace(target)
            finally:
                signal.alarm(0)
            result.inputs += len(batch)
            result.slowest = max(result.slowest, (time.monotonic() - started) / len(batch))
    finally:
        signal.signal(signal.SIGALRM, before)
        target.close()
    result.seconds = time.monotonic() - begin
    result.memory = _memory() - memory
    if result.memory > _MAX_MEMORY_GROWTH:
        result.crashes.append(f"{key}: the process grew by {result.memory:.0f} MB")
    return result


def _raise_hang(*_: object) -> None:
    raise HangError(f"a batch took longer than {HANG_TIMEOUT} s")


def _replace(target: Target) -> Target:
    """Return a new target in place of one that has crashed."""
    try:
        target.close()
    except Exception:
        traceback.print_exc()
    return type(target)()


def _report(key: str, seed: int, number: int, batch: Sequence[Any], trace: str) -> str:
    again = f"--target {key} --seed {seed} --first {number} --inputs {len(batch)}"
    lines = [f"{key}: crash; repeat it with: scripts/bench --fuzz {again}"]
    lines += [line[:200] for line in trace.rstrip().splitlines()[:_MAX_LINES_SHOWN]]
    for at, data in enumerate(batch[:_MAX_CRASHES_SHOWN]):
        lines.append(f"input {number + at} = {data!r}"[:_MAX_INPUT_SHOWN])
    return "\n".join(lines)


def _memory() -> float:
    """Return the highest memory of the process so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def table(results: Sequence[Result]) -> str:
    """Return a table with a row for each target, and one for all of them."""
    rows: list[tuple[object, ...]] = []
    for one in results:
        refused = ", ".join(
            f"{kind} {number:,}" for kind, number in one.kinds.most_common() if kind != ACCEPTED
        )
        rows.append(
            (
                one.name,
                f"{one.inputs:,}",
                f"{one.kinds[ACCEPTED]:,}",
                refused or "-",
                len(one.crashes),
                f"{one.inputs / max(one.seconds, 1e-9):,.0f}",
                f"{one.slowest * 1000:.0f}",
                f"{one.memory:.0f}",
            )
        )
    total, crashes = sum(one.inputs for one in results), sum(len(one.crashes) for one in results)
    rows.append(("all", f"{total:,}", "", "", crashes, "", "", ""))
    return markdown(
        (
            *("target", "inputs", "accepted", "refused, by kind"),
            *("crashes", "inputs/s", "slowest, ms", "MB"),
        ),
        rows,
        align="lrrlrrrr",
    )


def main(arguments: Sequence[str]) -> int:
    """Fuzz the targets and print the table.

    Returns:
        The exit status: 1 if anything crashed, otherwise 0.
    """
    parser = argparse.ArgumentParser(
        prog="scripts/bench --fuzz", description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument(
        "--inputs",
        type=int,
        default=1_000_000,
        help="number of inputs, for all targets together (default 1000000)",
    )
    parser.add_argument("--seed", type=int, help="seed of the inputs (default: a new one)")
    parser.add_argument(
        "--first", type=int, default=0, help="number of the first input (default 0)"
    )
    parser.add_argument(
        "--target", action="append", choices=TARGETS, help="only this target; may be repeated"
    )
    options = parser.parse_args(arguments)
    seed = random.randrange(2**32) if options.seed is None else options.seed
    keys = options.target or list(TARGETS)
    shares = sum(TARGETS[key].share for key in keys)
    print(f"seed {seed}", file=sys.stderr)
    logging.getLogger("woosh_robot_agent").setLevel(logging.ERROR)
    logging.getLogger("woosh_robot_agent").propagate = False
    # the library logs aborted handshakes as errors
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    results = []
    for key in keys:
        count = max(1, round(options.inputs * TARGETS[key].share / shares))
        results.append(fuzz(key, count, seed, options.first))
        for crash in results[-1].crashes[:_MAX_CRASHES_SHOWN]:
            print(crash, end="\n\n", file=sys.stderr)
        print(
            f"{key}: {results[-1].inputs} inputs, {len(results[-1].crashes)} crashes",
            file=sys.stderr,
        )
    print(table(results))
    print(f"\nseed {seed}")
    return int(any(one.crashes for one in results))
