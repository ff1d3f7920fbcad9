"""`monitor`: one robot on a terminal. It looks, and never commands."""

from __future__ import annotations

import argparse
import asyncio
import logging
import signal
import sys
from collections.abc import Sequence

from rich.console import Console
from rich.live import Live

from woosh_robot_agent.endpoints import NAMESPACE
from woosh_robot_agent.link.timeouts import run_with_timeout
from woosh_robot_agent.tools.keys import keys
from woosh_robot_agent.tools.link_source import LinkSource
from woosh_robot_agent.tools.options import add_link_options, link_config
from woosh_robot_agent.tools.reader import ends_with_its_reader
from woosh_robot_agent.tools.screen import draw
from woosh_robot_agent.tools.view import Source

_REDRAW = 0.2
_QUIT = ("q", "Q", "\x03", "\x04")
_EPILOG = """\
Without --ip it listens to the agent over ROS; with --ip straight to the robot, and needs no ROS.
q quits; no key commands the robot. With --once: exit status 0 if what is shown is what the robot
says now, else 1."""


@ends_with_its_reader
def main(arguments: Sequence[str] | None = None) -> int:
    """Show one robot until `q`, SIGINT or SIGTERM.

    Args:
        arguments: those of the command line if None.

    Returns:
        The exit status: 0; 1 if the output was not read, or, with `--once`, if the robot could not
        be seen.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    ros_at = given.index("--ros-args") if "--ros-args" in given else len(given)
    parser = argparse.ArgumentParser(
        prog="monitor",
        description="Show what one robot does.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_link_options(parser, ip_required=False)
    parser.add_argument("--namespace", default=NAMESPACE, help="of the agent; %(default)s")
    parser.add_argument("--once", action="store_true", help="print one picture, and end")
    parser.add_argument(
        "--interval", type=float, default=1.0, help="s between pictures where there is no terminal"
    )
    options = parser.parse_args(given[:ros_at])
    if not 0 < options.interval < 1e6:
        parser.error(f"--interval {options.interval} is not above 0")
    if not 0 < options.timeout < 1e6:
        parser.error(f"--timeout {options.timeout} is not above 0")
    # what the link would log is on the screen
    logging.getLogger("woosh_robot_agent").addHandler(logging.NullHandler())
    return asyncio.run(_run(_source(parser, options, given[ros_at:]), options))


def _source(
    parser: argparse.ArgumentParser, options: argparse.Namespace, ros_args: list[str]
) -> Source:
    if options.ip is not None:
        return LinkSource(link_config(parser, options))
    try:
        from woosh_robot_agent.tools.ros_source import RosSource
    except ImportError as error:
        parser.error(
            f"there is no ROS here ({error}): source its setup and the workspace's, or give --ip"
        )
    try:
        return RosSource(options.namespace, ros_args)
    except Exception as error:  # rclpy has one of its own for each kind of wrong argument
        parser.error(" ".join(str(error).split()))


async def _run(source: Source, options: argparse.Namespace) -> int:
    stopping = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stopping.set)
    console = Console()
    await source.start()
    try:
        if options.once:
            return await _once(source, console, stopping, options.timeout)
        if console.is_terminal:
            await _live(source, console, stopping)
        else:
            await _log(source, console, stopping, options.interval)
    finally:
        await source.close()
    return 0


async def _once(source: Source, console: Console, stopping: asyncio.Event, timeout: float) -> int:
    loop = asyncio.get_running_loop()
    deadline = loop.time() + timeout

    def seen() -> bool:
        return source.link().good and source.view.complete

    while not seen() and not stopping.is_set() and loop.time() < deadline:
        await _pause(stopping, 0.02)
    console.print(draw(source.name, source.link(), source.view))
    return int(not seen())


async def _live(source: Source, console: Console, stopping: asyncio.Event) -> None:
    def pressed(key: str) -> None:
        if key in _QUIT:
            stopping.set()

    with keys(pressed) as keyboard:
        hint = "q quits" if keyboard else ""
        with Live(console=console, screen=True, auto_refresh=False) as live:
            while not stopping.is_set():
                live.update(draw(source.name, source.link(), source.view, hint), refresh=True)
                await _pause(stopping, _REDRAW)


async def _log(source: Source, console: Console, stopping: asyncio.Event, interval: float) -> None:
    while not stopping.is_set():
        console.print(draw(source.name, source.link(), source.view))
        await _pause(stopping, interval)


async def _pause(stopping: asyncio.Event, seconds: float) -> None:
    try:
        await run_with_timeout(seconds, stopping.wait())
    except TimeoutError:
        pass


if __name__ == "__main__":
    sys.exit(main())
