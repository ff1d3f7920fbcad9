"""The program `doctor`, which runs all checks in order. It never commands the robot."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.reports import printable
from woosh_robot_agent.tools.doctor.checks import CHECKS, NOT_REACHED, Result, Status, examine
from woosh_robot_agent.tools.doctor.ros_graph import check_subscribers
from woosh_robot_agent.tools.options import (
    ToolError,
    above_zero,
    add_link_options,
    link_config,
    run_tool,
    tool_parser,
)

_MINUTES = 2.0
"""Default duration of a survey, in minutes."""
_MAX_MINUTES = 600
"""Maximum duration of a survey, in minutes."""
_NAME_WIDTH = max(map(len, CHECKS))
_EPILOG = """\
doctor requests RobotInfo once and never commands the robot. Where ROS is
available, it also looks for nodes that do not get the last value of a topic.

With --survey it then asks all queries and listens to all pushes, and writes
what the robot answers, how fast, and which fields and types are unknown. This
moves and changes nothing either; Ctrl-C ends it early. See docs/survey.md.

Exit status: 0 if no check failed (there may be warnings), 1 if a check failed
or the output was not read to its end, 2 if the command line is invalid."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Check one robot and print a line for each check.

    Returns:
        The exit status: 0 if no check failed; 1 if a check failed, or if the survey cannot be made.
    """
    parser = tool_parser(
        "doctor", "Check the connection to a robot and whether the robot accepts tasks.", _EPILOG
    )
    add_link_options(parser)
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object instead of lines"
    )
    parser.add_argument(
        "--survey",
        type=Path,
        metavar="FOLDER",
        help="then survey the robot: write what it answers and pushes to this new folder",
    )
    parser.add_argument(
        "--minutes",
        type=_minutes,
        help="duration of the survey; 10 while you drive the robot by hand "
        f"(default: {_MINUTES:g})",
    )
    parser.add_argument(
        "--with-names",
        action="store_true",
        help="keep names, addresses and serial numbers in the survey (default: leave them out)",
    )
    options = parser.parse_args(arguments)
    config = link_config(parser, options)
    if not options.survey and (options.minutes or options.with_names):
        parser.error("--minutes and --with-names need --survey")
    if options.survey and (config.transport, config.encoding) != ("websocket", "json"):
        parser.error("--survey needs --transport websocket and --encoding json")
    return run_tool(_run(config, options))


def _minutes(text: str) -> float:
    value = above_zero(text)
    if value > _MAX_MINUTES:
        raise argparse.ArgumentTypeError(f"must be at most {_MAX_MINUTES}: {text}")
    return value


async def _run(config: LinkConfig, options: argparse.Namespace) -> int:
    """Run the checks, and with --survey the survey; return the exit status.

    Raises:
        ToolError: the survey cannot be made, or its folder cannot be written.
    """
    if options.survey:
        from woosh_robot_agent.tools.doctor import survey  # slow to load, and seldom needed

        survey.check_folder(options.survey)
    results = await _examine_and_print(config, quiet=options.json)
    failed = any(result.status is Status.FAIL for result in results)
    if options.json:
        print(json.dumps(_as_json(config, results, failed), indent=2))
    if options.survey:
        # RobotInfo is the first check that needs the open link
        if any(each.check == "RobotInfo" and each.text == NOT_REACHED for each in results):
            raise ToolError("no survey, because the link to the robot does not open")
        minutes = options.minutes or _MINUTES
        text = await survey.survey(
            config, options.survey, minutes=minutes, with_names=options.with_names
        )
        print(text, file=sys.stderr if options.json else None)
    return int(failed)


async def _examine_and_print(config: LinkConfig, *, quiet: bool) -> list[Result]:
    """Run the checks, and print each result, unless `quiet`; return the results."""
    if not quiet:
        print(f"robot at {config.address}", flush=True)
    results = []
    async for result in examine(config):
        results.append(result)
        if not quiet and result.text != NOT_REACHED:
            print(_line(result), flush=True)
    # these share one line, the last one
    not_reached = [result.check for result in results if result.text == NOT_REACHED]
    results.append(replace(await check_subscribers(), check="subscribers"))
    if not quiet:
        print(_line(results[-1]))
        if not_reached:
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
