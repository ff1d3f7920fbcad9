"""The program `monitor`, which gets its data from an agent or directly from a chassis."""

from __future__ import annotations

import argparse
import asyncio
import logging
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from rich.console import Console
from rich.live import Live

from woosh_robot_agent.endpoints import NAMESPACE
from woosh_robot_agent.link import ChassisClient, LinkConfig
from woosh_robot_agent.link.tasks import run_main, run_with_timeout
from woosh_robot_agent.program import import_problem
from woosh_robot_agent.tools.monitor.screen import draw, key_presses
from woosh_robot_agent.tools.options import add_link_options, link_config, stop_event, tool_parser
from woosh_robot_agent.tools.robot_view import (
    MAX_BACKOFF,
    LinkReport,
    RobotView,
    link_report,
    subscribe_all,
)


class Source(Protocol):
    """Source of the state of one robot. Used in one asyncio event loop.

    Attributes:
        name: name of the source, shown as title.
        view: state of the robot as received so far.
    """

    name: str
    view: RobotView

    def link(self) -> LinkReport:
        """Return the current state of the link."""

    def is_complete(self) -> bool:
        """Return True once the robot's whole state has come, and all that `link` reports on."""

    async def start(self) -> None:
        """Start receiving."""

    async def close(self) -> None:
        """Stop receiving."""


class LinkSource:
    """Receives from one chassis; implements `Source`.

    It requests RobotInfo on each connection and never commands the robot.

    Args:
        config: configuration of the link; its `backoff_max` is replaced by `MAX_BACKOFF`.
    """

    def __init__(self, config: LinkConfig) -> None:
        self.name = config.address
        self.view = RobotView()
        self._chassis = ChassisClient(config=replace(config, backoff_max=MAX_BACKOFF))
        subscribe_all(self._chassis, self.view.update)

    async def start(self) -> None:
        self._chassis.start()

    async def close(self) -> None:
        await self._chassis.close()

    def is_complete(self) -> bool:
        return self.view.has_robot_info

    def link(self) -> LinkReport:
        return link_report(self._chassis)


_REDRAW_PERIOD = 0.2
"""Time between two updates of a terminal, in seconds."""
_PRINT_PERIOD = 1.0
"""Time between two prints if stdout is not a terminal, in seconds."""
_CHECK_PERIOD = 0.02
"""Time between two checks whether `--once` can print, in seconds."""
_QUIT_KEYS = ("q", "Q", "\x03", "\x04")  # the last two are Ctrl-C and Ctrl-D
_EPILOG = """\
Without --ip, the data comes from the agent, over ROS. With --ip, it comes
straight from the robot, and ROS is not needed.

The key q quits. No key commands the robot.

Exit status with --once: 0 if the printed state is up to date, 1 if it is not."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Show the state of one robot until `q`, SIGINT, SIGTERM or SIGHUP, or print it once.

    Returns:
        The exit status: 0; with `--once`, 1 if the printed state is incomplete or outdated.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    # rclpy parses --ros-args and what follows
    ros_at = given.index("--ros-args") if "--ros-args" in given else len(given)
    parser = tool_parser("monitor", "Show the state of one robot.", _EPILOG)
    add_link_options(parser, ip_required=False)
    parser.add_argument(
        "--namespace",
        default=NAMESPACE,
        help="namespace of the agent, without --ip (default: %(default)s)",
    )
    parser.add_argument(
        "--once",
        action="store_true",
        help="print the state once, after --timeout seconds at the latest, and exit",
    )
    options = parser.parse_args(given[:ros_at])
    # Silence the link's log: the screen shows the state of the link.
    logging.getLogger("woosh_robot_agent").addHandler(logging.NullHandler())
    return run_main(_run(_make_source(parser, options, given[ros_at:]), options))


def _make_source(
    parser: argparse.ArgumentParser, options: argparse.Namespace, ros_args: list[str]
) -> Source:
    if options.ip is not None:
        return LinkSource(link_config(parser, options))
    try:
        from woosh_robot_agent.tools.monitor.ros_source import RosSource
    except ImportError as error:
        if not (problem := import_problem(error)):
            raise
        parser.error(f"{problem}, or use --ip")
    try:
        return RosSource(options.namespace, ros_args)
    except Exception as error:  # rclpy raises a different type for each kind of invalid argument
        parser.error(" ".join(str(error).split()))


async def _run(source: Source, options: argparse.Namespace) -> int:
    stop = stop_event()
    console = Console()
    await source.start()
    try:
        if options.once:
            return await print_once(source, console, stop, options.timeout)
        if console.is_terminal:
            await _show_live(source, console, stop)
        else:
            await _print_repeatedly(source, console, stop)
    finally:
        await source.close()
    return 0


async def print_once(source: Source, console: Console, stop: asyncio.Event, timeout: float) -> int:
    """Print the state once it is complete, after `timeout` seconds, or when `stop` is set.

    Returns:
        The exit status: 0 if the state is complete and up to date, else 1.
    """
    loop = asyncio.get_running_loop()
    deadline = loop.time() + timeout

    def is_ready() -> bool:
        return source.link().good and source.is_complete()

    while not is_ready() and not stop.is_set() and loop.time() < deadline:
        await _pause(stop, _CHECK_PERIOD)
    console.print(draw(source.name, source.link(), source.view))
    return int(not is_ready())


async def _show_live(source: Source, console: Console, stop: asyncio.Event) -> None:
    def on_key(key: str) -> None:
        if key in _QUIT_KEYS:
            stop.set()

    with key_presses(on_key) as has_keyboard:
        hint = "q quits" if has_keyboard else ""
        with Live(console=console, screen=True, auto_refresh=False) as live:
            while not stop.is_set():
                live.update(draw(source.name, source.link(), source.view, hint), refresh=True)
                await _pause(stop, _REDRAW_PERIOD)


async def _print_repeatedly(source: Source, console: Console, stop: asyncio.Event) -> None:
    while not stop.is_set():
        console.print(draw(source.name, source.link(), source.view))
        await _pause(stop, _PRINT_PERIOD)


async def _pause(stop: asyncio.Event, duration: float) -> None:
    """Wait until `stop` is set, but at most `duration` seconds."""
    try:
        await run_with_timeout(duration, stop.wait())
    except TimeoutError:
        pass
