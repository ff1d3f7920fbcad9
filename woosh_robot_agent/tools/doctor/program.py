"""Command line and output of `doctor`."""

from __future__ import annotations

import argparse
import asyncio
import json
from collections.abc import Sequence

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.log_once import printable
from woosh_robot_agent.robot_clock import TOLERANCE
from woosh_robot_agent.stdout_errors import exit_on_stdout_error
from woosh_robot_agent.tools.doctor.examination import CHECKS, NOT_REACHED, examine
from woosh_robot_agent.tools.doctor.result import Result, Status
from woosh_robot_agent.tools.options import add_link_options, link_config

_NAME_WIDTH = max(map(len, CHECKS))
_EPILOG = """\
doctor requests RobotInfo once and never commands the robot.

Exit status: 0 if no check failed (there may be warnings), 1 if a check failed
or the output could not be written or was not read to its end, 2 if the command
line is invalid."""


@exit_on_stdout_error
def main(arguments: Sequence[str] | None = None) -> int:
    """Check one robot and print a line for each check.

    Args:
        arguments: Arguments of the program; by default those of the command line.

    Returns:
        The exit status: 0 if no check failed, 1 if one failed or the output was not read.
    """
    parser = argparse.ArgumentParser(
        prog="doctor",
        description="Check the connection to a robot and whether the robot accepts tasks.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_link_options(parser)
    parser.add_argument(
        "--max-skew",
        type=float,
        default=TOLERANCE,
        help="maximum difference of the clocks, in seconds (default: %(default)g)",
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object instead of lines"
    )
    options = parser.parse_args(arguments)
    if not options.max_skew >= 0:  # NaN is not, either
        parser.error(f"--max-skew must be 0 or above: {options.max_skew}")
    config = link_config(parser, options)
    results = asyncio.run(_examine(config, options.max_skew, quiet=options.json))
    failed = any(result.status is Status.FAIL for result in results)
    if options.json:
        print(json.dumps(_as_json(config, results, failed), indent=2))
    return int(failed)


async def _examine(config: LinkConfig, max_skew: float, *, quiet: bool) -> list[Result]:
    """Run the checks; print each result unless `quiet`."""
    if not quiet:
        print(f"robot at {config.address}", flush=True)
    results = []
    async for result in examine(config, max_skew):
        results.append(result)
        if not quiet and result.text != NOT_REACHED:
            print(_line(result), flush=True)
    not_reached = [result.check for result in results if result.text == NOT_REACHED]
    if not_reached and not quiet:
        print(f"{Status.SKIPPED.value:<5} {', '.join(not_reached)}: {NOT_REACHED}")
    return results


def _line(result: Result) -> str:
    line = f"{result.status.value:<5} {result.check:<{_NAME_WIDTH}}  {printable(result.text)}"
    if result.remedy:
        line += f"\n{'':<5} {'':<{_NAME_WIDTH}}  -> {printable(result.remedy)}"
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
