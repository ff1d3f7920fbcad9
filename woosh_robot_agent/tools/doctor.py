"""`doctor`: why does the robot not do what it should? Checks the way to it and its readiness."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from collections.abc import Sequence

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.tools.checks import CHECKS, NOT_REACHED, Result, Status, examine
from woosh_robot_agent.tools.options import add_link_options, link_config
from woosh_robot_agent.tools.reader import ends_with_its_reader

_WIDTH = max(map(len, CHECKS))
_EPILOG = """\
Exit status: 0 nothing failed (warnings are allowed), 1 a check failed, or nobody
read this to its end, 2 wrong usage.
It asks the robot for RobotInfo once and never commands it."""


@ends_with_its_reader
def main(arguments: Sequence[str] | None = None) -> int:
    """Check one robot and print a line for each check.

    Args:
        arguments: those of the command line if None.

    Returns:
        The exit status: 0 if nothing failed, 1 if something did or the output was not read.
    """
    parser = argparse.ArgumentParser(
        prog="doctor",
        description="Check the way to a robot and whether it would take a task.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_link_options(parser)
    parser.add_argument(
        "--max-skew", type=float, default=1.0, help="s by which the clocks may differ"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object, for scripts")
    options = parser.parse_args(arguments)
    if not options.max_skew >= 0:  # nor is NaN
        parser.error(f"--max-skew {options.max_skew} is not 0 or above")
    config = link_config(parser, options)
    try:
        results = asyncio.run(_run(config, options.max_skew, quiet=options.json))
    except KeyboardInterrupt:
        return 130
    failed = any(result.status is Status.FAIL for result in results)
    if options.json:
        print(json.dumps(_as_json(config, results, failed), indent=2, ensure_ascii=False))
    return int(failed)


async def _run(config: LinkConfig, max_skew: float, *, quiet: bool) -> list[Result]:
    if not quiet:
        print(f"robot at {config.address}", flush=True)
    results = []
    async for result in examine(config, max_skew):
        results.append(result)
        if not quiet and result.text != NOT_REACHED:
            print(_line(result), flush=True)
    rest = [result.check for result in results if result.text == NOT_REACHED]
    if rest and not quiet:
        print(f"{Status.SKIPPED.value:<5} {', '.join(rest)}: {NOT_REACHED}")
    return results


def _line(result: Result) -> str:
    line = f"{result.status.value:<5} {result.check:<{_WIDTH}}  {result.text}"
    if result.remedy:
        line += f"\n{'':<5} {'':<{_WIDTH}}  -> {result.remedy}"
    return line


def _as_json(config: LinkConfig, results: list[Result], failed: bool) -> dict[str, object]:
    return {
        "address": config.address,
        "ok": not failed,
        "checks": [
            {
                "check": result.check,
                "status": result.status.value.lower(),
                "text": result.text,
                "remedy": result.remedy,
            }
            for result in results
        ],
    }


if __name__ == "__main__":
    sys.exit(main())
