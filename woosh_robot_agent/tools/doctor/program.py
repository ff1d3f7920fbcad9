"""The program `doctor`, which runs all checks in order. It never commands the robot."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import AsyncIterator, Sequence
from dataclasses import replace
from pathlib import Path

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.reports import printable
from woosh_robot_agent.link.tasks import run_main
from woosh_robot_agent.robot.clock import TOLERANCE
from woosh_robot_agent.tools.doctor import SurveyError
from woosh_robot_agent.tools.doctor.checks import (
    CheckFailedError,
    Result,
    Status,
    check_clock,
    check_codes,
    check_emergency_stop,
    check_identity,
    check_initialisation,
    check_localisation,
    check_mode,
    check_taskable,
    find_reachable,
    open_link,
    own_address,
    request_robot_info,
)
from woosh_robot_agent.tools.doctor.ros_graph import check_subscribers
from woosh_robot_agent.tools.options import above_zero, add_link_options, link_config, tool_parser

CHECKS = (
    "network",
    "port",
    "handshake",
    "RobotInfo",
    "mode",
    "initialisation",
    "localisation",
    "emergency stop",
    "taskable",
    "status codes",
    "clock",
)
"""Names of the checks of the robot, in order."""
NOT_REACHED = "not checked, because an earlier check failed"
"""Text of the checks that were not reached."""


async def examine(config: LinkConfig, max_skew: float = TOLERANCE) -> AsyncIterator[Result]:
    """Check one robot; yield the result of each of `CHECKS` as soon as it is known.

    `max_skew` is the maximum difference of the clocks, in seconds.
    """
    names = iter(CHECKS)
    try:
        async for result in _run_checks(config, max_skew):
            yield replace(result, check=next(names))
    except CheckFailedError as error:
        yield replace(error.result, check=next(names))
    for name in names:
        yield Result(Status.SKIPPED, NOT_REACHED, check=name)


async def _run_checks(config: LinkConfig, max_skew: float) -> AsyncIterator[Result]:
    """Yield the results in the order of `CHECKS`, without the names of the checks."""
    address, closed_reason = await find_reachable(config)
    yield Result(Status.OK, f"{address.ip} is reachable from {own_address(address)}")
    if closed_reason:
        raise CheckFailedError(
            f"port {config.effective_port} is closed: {closed_reason}",
            "check --ip and --transport; if they are right, the robot's program is not running: "
            "wait until it has started, or switch the robot off and on",
        )
    yield Result(Status.OK, f"{config.effective_port} is open")
    transport = await open_link(config)
    try:
        is_tcp = config.transport == "tcp"
        yield Result(Status.OK, "not needed over tcp" if is_tcp else "the WebSocket is open")
        answer = await request_robot_info(transport, config)
    finally:
        await transport.close(config.close_timeout)
    yield check_identity(answer)
    yield check_mode(answer.info)
    yield check_initialisation(answer.info)
    yield check_localisation(answer.info)
    yield check_emergency_stop(answer.info)
    yield check_taskable(answer.info)
    yield check_codes(answer.info)
    yield check_clock(answer, max_skew)


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
    return run_main(_run(config, options))


def _minutes(text: str) -> float:
    value = above_zero(text)
    if value > _MAX_MINUTES:
        raise argparse.ArgumentTypeError(f"must be at most {_MAX_MINUTES}: {text}")
    return value


async def _run(config: LinkConfig, options: argparse.Namespace) -> int:
    """Run the checks, and with --survey the survey; return the exit status."""
    try:
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
                raise SurveyError("no survey, because the link to the robot does not open")
            minutes = options.minutes or _MINUTES
            text = await survey.survey(
                config, options.survey, minutes=minutes, with_names=options.with_names
            )
            print(text, file=sys.stderr if options.json else None)
    except SurveyError as error:
        print(printable(f"error: {error}"), file=sys.stderr)
        return 1
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
    # one line for all of them, at the end
    not_reached = [result.check for result in results if result.text == NOT_REACHED]
    results.append(await check_subscribers())
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
