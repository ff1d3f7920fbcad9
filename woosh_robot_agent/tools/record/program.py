"""`record`: all frames between a robot and its clients, with their times, into a file."""

from __future__ import annotations

import argparse
import asyncio
import logging
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

from woosh_robot_agent.endpoints import QUERIES, TOPICS
from woosh_robot_agent.link import ChassisClient, LinkConfig, LinkError, LinkState
from woosh_robot_agent.link.config import MIB
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.protos import message_type
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.tools.listen import host_and_port
from woosh_robot_agent.tools.options import add_link_options, link_config, warn_if_not_local
from woosh_robot_agent.tools.recorder import Recorder
from woosh_robot_agent.tools.recording import Writer

_LOCAL = "127.0.0.1"
_EPILOG = """\
With --listen it stands between the agent and the robot: point the agent to it, and everything that
passes is recorded, commands included. Without, it connects by itself, subscribes to everything and
asks for everything once, and never commands the robot. Ctrl-C ends it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM.

    Args:
        arguments: those of the command line if None.

    Returns:
        The exit status: 0, or 1 if it could not listen or write.
    """
    parser = argparse.ArgumentParser(
        prog="record",
        description="Record all frames between a robot and its clients.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_link_options(parser)
    parser.add_argument(
        "--listen", type=host_and_port, metavar="HOST:PORT", help="take clients there, 0: any port"
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path(time.strftime("recording-%Y%m%d-%H%M%S.jsonl.gz")),
        help="the file, which must not exist; compressed if its name ends in .gz",
    )
    parser.add_argument(
        "--max-size", type=float, default=1024.0, help="MiB after which the recording ends"
    )
    parser.add_argument("--duration", type=float, help="s after which to end; default: never")
    options = parser.parse_args(arguments)
    config = link_config(parser, options)
    if not options.max_size > 0:
        parser.error(f"--max-size {options.max_size} is not above 0")
    if options.duration is not None and not options.duration > 0:
        parser.error(f"--duration {options.duration} is not above 0")
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        return asyncio.run(_run(config, options))
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


async def _run(config: LinkConfig, options: argparse.Namespace) -> int:
    stopping = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stopping.set)

    def ended(reason: str) -> None:
        more = "; clients are served on" if options.listen else ""
        print(f"error: the recording has ended: {reason}{more}", file=sys.stderr, flush=True)
        if not options.listen:  # an agent that goes through us needs us; nobody else does
            stopping.set()

    writer = Writer(options.output, config.address, int(options.max_size * MIB), ended)
    try:
        recorder = Recorder(config, writer)
        host, port = options.listen or (_LOCAL, 0)
        async with AsyncExitStack() as stack:
            try:
                port = await recorder.start(host, port)
            except OSError:
                options.output.unlink()  # nothing is in it, and it would be in the way
                raise
            stack.push_async_callback(recorder.stop)
            if options.listen:
                warn_if_not_local(host, "can command the robot")
                _tell_how(config, host, port, writer.path)
            else:
                print(f"recording {config.address} into {writer.path}", flush=True)
                own = Listener(replace(config, ip=_LOCAL, port=port))
                stack.push_async_callback(own.close)
                own.start()
            await _wait(stopping, options.duration)
    finally:
        writer.close()
    print(f"{writer.frames} frames of {writer.connections} connections in {writer.path}")
    return int(writer.ended != "closed")


def _tell_how(config: LinkConfig, host: str, port: int, path: Path) -> None:
    print(
        f"recording {config.address} into {path}; connect the agent to {host}:{port}, e.g. with\n"
        f"  ros2 run woosh_robot_agent agent --ros-args -r __ns:=/woosh_robot "
        f"-p ip:={host} -p port:={port} -p transport:={config.transport}",
        flush=True,
    )


async def _wait(stopping: asyncio.Event, duration: float | None) -> None:
    await asyncio.wait({asyncio.ensure_future(stopping.wait())}, timeout=duration)


class Listener:
    """A client that wants to hear everything and says nothing.

    Args:
        config: of the recorder, which passes it on.
    """

    def __init__(self, config: LinkConfig) -> None:
        self._chassis = ChassisClient(config=config)
        for topic in TOPICS:
            self._chassis.subscribe(message_type(topic.push), _ignore)
        self._chassis.subscribe(Feedbacks, _ignore)
        self._chassis.on_state(self._changed)
        self._asking: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Connect, and again whenever the connection is lost."""
        self._chassis.start()

    async def close(self) -> None:
        """Hang up."""
        if self._asking is not None:
            self._asking.cancel()
        await self._chassis.close()

    def _changed(self, state: LinkState) -> None:
        if self._asking is not None:
            self._asking.cancel()
        if state is LinkState.READY:
            self._asking = asyncio.get_running_loop().create_task(self._ask())

    async def _ask(self) -> None:
        """Ask for everything that can be asked: what is replayed has to answer it."""
        requests = RequestMaker(self._chassis.config.robot_id)
        for name in dict.fromkeys(query.request for query in QUERIES):
            try:
                await self._chassis.request(requests.empty(message_type(name)))
            except LinkError as error:
                logging.getLogger(__name__).info("%s: %s", name, error)


def _ignore(_message: object) -> None:
    """The recorder has it already."""


if __name__ == "__main__":
    sys.exit(main())
