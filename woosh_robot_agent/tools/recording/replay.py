"""The program `replay`, which plays a recording back as a simulated chassis."""

from __future__ import annotations

import argparse
import asyncio
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

from woosh_robot_agent.link.config import DEFAULT_PORTS, url_host
from woosh_robot_agent.link.reports import log_to_stderr, printable
from woosh_robot_agent.tools.options import (
    ToolError,
    above_zero,
    stop_event,
    tool_parser,
    warn_if_not_local,
)
from woosh_robot_agent.tools.recording.layout import Recording
from woosh_robot_agent.tools.recording.reader import read_recording
from woosh_robot_agent.tools.recording.replayed_chassis import ReplayedChassis
from woosh_robot_agent.tools.recording.timeline import Playback, prepare

_EPILOG = """\
The playback starts when a client has subscribed. Requests get the recorded
answers in their recorded order. A request of a type that was not recorded is
refused. Recorded losses of the connection are replayed.

Ctrl-C ends the program."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Replay a recording until SIGINT, SIGTERM or SIGHUP.

    Returns:
        The exit status: 0, or 1 if a file cannot be used or the program cannot listen.
    """
    parser = make_parser()
    options = parser.parse_args(arguments)
    for port in (options.port, options.tcp_port):
        if not 0 <= port < 2**16:
            parser.error(f"port must be in 0..65535: {port}")
    log_to_stderr(logging.INFO, "%(message)s")
    try:
        recording = read_recording(*options.file)
        playback = prepare(recording)
        _print_summary(options.file[0], playback, recording)
        asyncio.run(_run(playback, options))
    except ToolError as error:
        print(printable(f"error: {error}"), file=sys.stderr)
        return 1
    return 0


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = tool_parser(
        "replay", "Simulate the chassis of a recording made with `record`.", _EPILOG
    )
    parser.add_argument(
        "file",
        type=Path,
        nargs="+",
        help="file of the recording; for a split recording, all its files",
    )
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to listen on (default: %(default)s)"
    )
    for name, transport in (("--port", "websocket"), ("--tcp-port", "tcp")):
        parser.add_argument(
            name,
            type=int,
            default=DEFAULT_PORTS[transport],
            help=f"port of the {transport} transport; 0 selects a free one (default: %(default)s)",
        )
    parser.add_argument(
        "--speed",
        type=above_zero,
        default=1.0,
        help="speed of the playback as a factor (default: %(default)g)",
    )
    parser.add_argument(
        "--loop",
        action="store_true",
        help="drop all clients and start again when the recording ends",
    )
    parser.add_argument(
        "--wait-for-commands",
        action="store_true",
        help="pause at each recorded command until a client sends one of its type",
    )
    return parser


def _print_summary(path: Path, playback: Playback, recording: Recording) -> None:
    print(
        f"{path}: {playback.duration:.1f} s, {len(playback.steps)} steps, "
        f"{len(playback.answers.types)} types of requests"
    )
    if recording.damage:
        text = f"warning: the end of the recording is missing: {recording.damage}"
        print(printable(text), file=sys.stderr)
    if recording.missing_parts:
        numbers = ", ".join(map(str, recording.missing_parts))
        print(
            "warning: files of this split recording are not given, so the playback lacks what "
            f"they have; the numbers in their names: {numbers}",
            file=sys.stderr,
        )
    if playback.answers.unmatched:
        print(
            f"warning: answers without a request are left out: {playback.answers.unmatched}",
            file=sys.stderr,
        )


async def _run(playback: Playback, options: argparse.Namespace) -> None:
    """Play until a signal; raise `ToolError` if the program cannot listen."""
    stop = stop_event()
    warn_if_not_local(options.host, "can read what was recorded")
    chassis = ReplayedChassis(
        playback,
        host=options.host,
        port=options.port,
        tcp_port=options.tcp_port,
        speed=options.speed,
        loop=options.loop,
        wait_for_commands=options.wait_for_commands,
    )
    try:
        await chassis.start()
    except OSError as error:
        raise ToolError(
            f"cannot listen on {options.host}: {error.strerror or error}; choose another address "
            "or other ports: --host, --port and --tcp-port"
        ) from None
    try:
        host = url_host(options.host)
        print(
            f"replayed chassis ready on ws://{host}:{chassis.port} "
            f"and tcp://{host}:{chassis.tcp_port}",
            flush=True,
        )
        await chassis.wait(stop)
    finally:
        await chassis.stop()
