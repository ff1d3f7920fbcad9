"""`scripts/bench --faults`: the agent's promises under every fault, alone and in pairs."""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from itertools import groupby

from benchmarks.figures import markdown
from benchmarks.robustness.rig import KINDS, BrokenPromiseError, Rig
from benchmarks.robustness.scenarios import BACK_WITHIN, BLOCK, Outcome, plan, run
from woosh_robot_agent.simulator.faults import FAULTS

NOTICED_WITHIN = 10.0
"""Maximum time until an agent with default parameters notices a half-open link, in seconds."""
_COLUMNS = (
    "Fault",
    "Scenarios",
    "Calls",
    "Answered exactly once",
    "Goals",
    "Ended",
    "Slowest recovery, s",
    "Violations",
)


def main(arguments: Sequence[str]) -> int:
    """Run scenarios and print the table.

    Returns:
        The exit status: 1 if a promise was broken, otherwise 0.
    """
    parser = argparse.ArgumentParser(
        prog="scripts/bench --faults",
        description="Runs seeded scenarios of traffic with every fault, alone and in pairs. The "
        "exit status is 1 if a promise is broken.",
    )
    parser.add_argument("--seed", type=int, default=0, help="first seed (default 0)")
    parser.add_argument(
        "--count", type=int, default=1000, help="number of scenarios (default 1000)"
    )
    parser.add_argument("--jobs", type=int, default=2, help="number of processes (default 2)")
    parser.add_argument(
        "--no-half-open",
        action="store_true",
        help="do not measure how soon a half-open link is noticed",
    )
    options = parser.parse_args(arguments)
    seeds = range(options.seed, options.seed + options.count)
    begin = time.monotonic()
    outcomes = []
    for outcome in _run_all(seeds, options.jobs):
        outcomes.append(outcome)
        for violation in outcome.violations:
            print(
                f"seed {outcome.seed} ({' + '.join(outcome.faults)}): {violation}\n"
                f"    repeat it with: scripts/bench --faults --seed {outcome.seed} --count 1",
                file=sys.stderr,
                flush=True,
            )
        if len(outcomes) % 50 == 0:
            duration = time.monotonic() - begin
            print(f"{len(outcomes)} of {len(seeds)}, {duration:.0f} s", file=sys.stderr, flush=True)
    print(table(outcomes))
    failed = len(outcomes) < len(seeds) or any(outcome.violations for outcome in outcomes)
    print(f"\n{len(outcomes)} scenarios in {time.monotonic() - begin:.0f} s.")
    if options.count > 1 and not options.no_half_open:
        print("\n| Half-open link, default parameters | Noticed after, s |\n| --- | --- |")
        for kind in KINDS:
            noticed = notice_half_open(kind)
            failed = failed or noticed > NOTICED_WITHIN
            print(f"| {kind['transport']}, {kind['encoding']} | {noticed:.2f} |", flush=True)
    return int(failed)


def table(outcomes: Iterable[Outcome]) -> str:
    """Return a table with a row for each fault. A scenario with two faults counts for both."""
    outcomes = list(outcomes)
    rows = [
        _row(f"`{name}`", [each for each in outcomes if name in each.faults]) for name in FAULTS
    ]
    return markdown(_COLUMNS, [*rows, _row("all", outcomes)])


def _row(title: str, outcomes: list[Outcome]) -> tuple[str, ...]:
    return (
        title,
        str(len(outcomes)),
        str(sum(each.calls for each in outcomes)),
        str(sum(each.answered_once for each in outcomes)),
        str(sum(each.goals for each in outcomes)),
        str(sum(each.goals_ended for each in outcomes)),
        f"{max((each.recovery for each in outcomes), default=0.0):.2f}",
        str(sum(len(each.violations) for each in outcomes)),
    )


def _run_all(seeds: Sequence[int], jobs: int) -> Iterator[Outcome]:
    """Yield outcomes as scenarios end. The seeds of a block share a process and a rig."""
    blocks = [list(block) for _, block in groupby(seeds, lambda seed: seed // BLOCK)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context) as pool:
        running = {pool.submit(run_block, block): block for block in blocks}
        for done in as_completed(running):
            try:
                yield from done.result()
            except BrokenProcessPool:
                print(
                    f"the process that ran the seeds {running[done]} died",
                    file=sys.stderr,
                    flush=True,
                )


def run_block(seeds: Sequence[int], back_within: float = BACK_WITHIN) -> list[Outcome]:
    """Run scenarios one after the other, with a new rig after a broken promise."""
    outcomes: list[Outcome] = []
    rig: Rig | None = None
    try:
        for seed in seeds:
            scenario = plan(seed)
            if rig is None:
                rig = Rig(scenario.kind)
            outcomes.append(run(rig, scenario, back_within))
            if outcomes[-1].violations:
                rig.close()
                rig = None
    finally:
        if rig is not None:
            rig.close()
    return outcomes


def notice_half_open(kind: dict[str, str]) -> float:
    """Return how soon an agent with default parameters notices a half-open link, in seconds."""
    rig = Rig(kind, parameters={})
    try:
        rig.simulator.inject("half_open")
        begin = time.monotonic()
        while rig.ready:
            time.sleep(0.005)
            if time.monotonic() - begin > 3 * NOTICED_WITHIN:
                raise BrokenPromiseError("a half-open link was not noticed")
        return time.monotonic() - begin
    finally:
        rig.close()
