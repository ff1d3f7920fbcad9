"""Command line of `record`."""

from __future__ import annotations

import argparse
import asyncio
import logging
import sys
import time
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.config import MIB
from woosh_robot_agent.stdout_errors import exit_on_stdout_error
from woosh_robot_agent.tools.options import (
    add_link_options,
    host_and_port,
    link_config,
    warn_if_not_local,
)
from woosh_robot_agent.tools.record.passive_client import PassiveClient
from woosh_robot_agent.tools.record.proxy import RecordingProxy
from woosh_robot_agent.tools.recording.writer import RecordingWriter
from woosh_robot_agent.tools.stop_event import stop_event

_LOCALHOST = "127.0.0.1"
_EPILOG = """\
With --listen, record is a proxy between the agent and the robot: connect the
agent to it, and all traffic is recorded, commands included.
Without --listen, record connects to the robot by itself, subscribes to
everything and sends each query once. It never commands the robot.

Ctrl-C ends the recording."""


@exit_on_stdout_error
def main(arguments: Sequence[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM.

    Args:
        arguments: Arguments of the program; by default those of the command line.

    Returns:
        The exit status: 0, or 1 if the program could not listen or the recording ended early.
    """
    parser = argparse.ArgumentParser(
        prog="record",
        description="Record all frames between a robot and its clients.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_link_options(parser)
    parser.add_argument(
        "--listen",
        type=host_and_port,
        metavar="HOST:PORT",
        help="address and port to listen on for clients; port 0 selects a free one",
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path(time.strftime("recording-%Y%m%d-%H%M%S.jsonl.gz")),
        help="file to create; it must not exist, and is compressed if its name ends in .gz "
        "(default: recording-DATE-TIME.jsonl.gz)",
    )
    parser.add_argument(
        "--max-size",
        type=float,
        default=1024.0,
        help="maximum size of the file, in MiB; reaching it ends the recording "
        "(default: %(default)g)",
    )
    parser.add_argument(
        "--duration", type=float, help="duration of the recording, in seconds (default: no limit)"
    )
    options = parser.parse_args(arguments)
    config = link_config(parser, options)
    if not options.max_size > 0:
        parser.error(f"--max-size must be above 0: {options.max_size}")
    if options.duration is not None and not options.duration > 0:
        parser.error(f"--duration must be above 0: {options.duration}")
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        return asyncio.run(_run(config, options))
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


async def _run(config: LinkConfig, options: argparse.Namespace) -> int:
    stop = stop_event()

    def on_early_end(reason: str) -> None:
        # An agent that is connected through the proxy needs it even without a recording.
        more = "; the proxy keeps running" if options.listen else ""
        print(f"error: the recording has ended: {reason}{more}", file=sys.stderr, flush=True)
        if not options.listen:
            stop.set()

    writer = RecordingWriter(
        options.output, config.address, int(options.max_size * MIB), on_early_end
    )
    try:
        proxy = RecordingProxy(config, writer)
        host, port = options.listen or (_LOCALHOST, 0)
        async with AsyncExitStack() as stack:
            try:
                port = await proxy.start(host, port)
            except OSError:
                options.output.unlink()  # it is empty, and would block the next attempt
                raise
            stack.push_async_callback(proxy.stop)
            if options.listen:
                warn_if_not_local(host, "can command the robot")
                _print_instructions(config, host, port, writer.path)
            else:
                print(f"recording {config.address} to {writer.path}", flush=True)
                client = PassiveClient(replace(config, ip=_LOCALHOST, port=port))
                stack.push_async_callback(client.close)
                client.start()
            await _wait(stop, options.duration)
    finally:
        writer.close()
    print(f"recorded {writer.frames} frames of {writer.connections} connections to {writer.path}")
    return int(writer.failed)


def _print_instructions(config: LinkConfig, host: str, port: int, path: Path) -> None:
    print(
        f"recording {config.address} to {path}; connect the agent to {host}:{port}, e.g. with\n"
        f"  ros2 run woosh_robot_agent agent --ros-args -r __ns:=/woosh_robot "
        f"-p ip:={host} -p port:={port} -p transport:={config.transport}",
        flush=True,
    )


async def _wait(stop: asyncio.Event, duration: float | None) -> None:
    await asyncio.wait({asyncio.ensure_future(stop.wait())}, timeout=duration)
