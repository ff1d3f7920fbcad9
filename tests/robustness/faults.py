"""`scripts/bench --faults`: what the agent promises, under every fault alone and in pairs."""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from itertools import groupby

from tests.robustness.rig import KINDS, Rig, Trouble
from tests.robustness.scenarios import BACK_WITHIN, BLOCK, Outcome, plan, run
from woosh_robot_agent.simulator.faults import FAULTS

NOTICED_WITHIN = 10.0
"""s within which a half-open link must be noticed with the default parameters."""
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
        0, or 1 where a promise was broken.
    """
    parser = argparse.ArgumentParser(
        prog="scripts/bench --faults",
        description="Seeded scenarios of traffic with each fault alone and in pairs. The exit "
        "status is 1 if a promise was broken.",
    )
    parser.add_argument("--seed", type=int, default=0, help="the first seed; default 0")
    parser.add_argument("--count", type=int, default=1000, help="how many; default 1000")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time; default 2")
    parser.add_argument(
        "--no-half-open", action="store_true", help="do not time the notice of a half-open link"
    )
    options = parser.parse_args(arguments)
    seeds = range(options.seed, options.seed + options.count)
    begun = time.monotonic()
    outcomes = []
    for outcome in _all(seeds, options.jobs):
        outcomes.append(outcome)
        for violation in outcome.violations:
            print(
                f"seed {outcome.seed} ({' + '.join(outcome.faults)}): {violation}\n"
                f"    again: scripts/bench --faults --seed {outcome.seed} --count 1",
                file=sys.stderr,
                flush=True,
            )
        if len(outcomes) % 50 == 0:
            taken = time.monotonic() - begun
            print(f"{len(outcomes)} of {len(seeds)}, {taken:.0f} s", file=sys.stderr, flush=True)
    print(table(outcomes))
    failed = len(outcomes) < len(seeds) or any(outcome.violations for outcome in outcomes)
    print(f"\n{len(outcomes)} scenarios in {time.monotonic() - begun:.0f} s.")
    if options.count > 1 and not options.no_half_open:
        print("\n| Half-open link, default parameters | Noticed after, s |\n| --- | --- |")
        for kind in KINDS[::2] + KINDS[3:]:
            noticed = notice_half_open(kind)
            failed = failed or noticed > NOTICED_WITHIN
            print(f"| {kind['transport']}, {kind['encoding']} | {noticed:.2f} |", flush=True)
    return int(failed)


def table(outcomes: Iterable[Outcome]) -> str:
    """The results in Markdown, a row per fault; a scenario of two faults counts for both."""
    outcomes = list(outcomes)
    rows = [_COLUMNS, ("---",) * len(_COLUMNS)]
    for name in FAULTS:
        rows.append(_row(f"`{name}`", [each for each in outcomes if name in each.faults]))
    rows.append(_row("all", outcomes))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


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


def _all(seeds: Sequence[int], jobs: int) -> Iterator[Outcome]:
    """Outcomes as they come; seeds of one block share a process and a rig."""
    blocks = [list(block) for _, block in groupby(seeds, lambda seed: seed // BLOCK)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context) as pool:
        running = {pool.submit(run_block, block): block for block in blocks}
        for done in as_completed(running):
            try:
                yield from done.result()
            except BrokenProcessPool:
                print(f"the process of seeds {running[done]} died", file=sys.stderr, flush=True)


def run_block(seeds: Sequence[int], back_within: float = BACK_WITHIN) -> list[Outcome]:
    """Run scenarios one after the other, with a new rig where a promise was broken."""
    outcomes: list[Outcome] = []
    rig: Rig | None = None
    try:
        for seed in seeds:
            what = plan(seed)
            if rig is None:
                rig = Rig(what.kind)
            outcomes.append(run(rig, what, back_within))
            if not outcomes[-1].clean:
                rig.close()
                rig = None
    finally:
        if rig is not None:
            rig.close()
    return outcomes


def notice_half_open(kind: dict[str, str]) -> float:
    """The s from a link's becoming half-open until an agent with default parameters notices."""
    rig = Rig(kind, parameters={})
    try:
        rig.simulator.inject("half_open")
        begun = time.monotonic()
        while rig.ready:
            time.sleep(0.005)
            if time.monotonic() - begun > 3 * NOTICED_WITHIN:
                raise Trouble("a half-open link was not noticed")
        return time.monotonic() - begun
    finally:
        rig.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
