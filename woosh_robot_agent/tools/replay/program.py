"""`replay`: a chassis that does again what `record` has recorded."""

from __future__ import annotations

import argparse
import asyncio
import logging
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from woosh_robot_agent.link.config import DEFAULT_PORTS
from woosh_robot_agent.tools.options import warn_if_not_local
from woosh_robot_agent.tools.playback import Playback, prepare
from woosh_robot_agent.tools.recording import RecordingError, read
from woosh_robot_agent.tools.replayer import ReplayedChassis

_EPILOG = """\
Time stands still until a client has subscribed. Requests get the answers that were recorded, in
their order; what was not recorded is refused. Recorded losses of the connection are replayed."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Replay a recording until SIGINT or SIGTERM.

    Args:
        arguments: those of the command line if None.

    Returns:
        The exit status: 0, or 1 if the file cannot be read or a port is taken.
    """
    parser = argparse.ArgumentParser(
        prog="replay",
        description="A chassis that replays what `record` recorded.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("file", type=Path, help="the recording")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen at")
    for name, transport in (("--port", "websocket"), ("--tcp-port", "tcp")):
        parser.add_argument(
            name,
            type=int,
            default=DEFAULT_PORTS[transport],
            help=f"port for {transport}, 0: any; default: %(default)s",
        )
    parser.add_argument("--speed", type=float, default=1.0, help="how much faster than recorded")
    parser.add_argument("--loop", action="store_true", help="begin again at the end")
    parser.add_argument(
        "--wait-for-commands",
        action="store_true",
        help="stand still at each recorded command until a client sends one of its type",
    )
    options = parser.parse_args(arguments)
    if not 0 < options.speed < 1e6:
        parser.error(f"--speed {options.speed} is not above 0")
    for port in (options.port, options.tcp_port):
        if not 0 <= port < 2**16:
            parser.error(f"port {port} is not in 0..65535")
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    # The library logs each handshake that is broken off, which is an everyday matter for a port.
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    try:
        recording = read(options.file)
        playback = prepare(recording)
        _tell(options.file, playback, recording.damage)
        asyncio.run(_run(playback, options))
    except (OSError, RecordingError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _tell(path: Path, playback: Playback, damage: str) -> None:
    print(
        f"{path}: {playback.duration:.1f} s, {len(playback.steps)} steps, "
        f"{len(playback.answers.types)} types of requests"
    )
    if damage:
        print(f"warning: {damage}: what was recorded after that is missing", file=sys.stderr)
    if playback.strays:
        print(
            f"warning: {playback.strays} answers to nothing that was asked are left out",
            file=sys.stderr,
        )


async def _run(playback: Playback, options: argparse.Namespace) -> None:
    stopping = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stopping.set)
    warn_if_not_local(options.host, "can see what was recorded")
    async with ReplayedChassis(
        playback,
        host=options.host,
        port=options.port,
        tcp_port=options.tcp_port,
        speed=options.speed,
        loop=options.loop,
        wait_for_commands=options.wait_for_commands,
    ) as chassis:
        host = f"[{options.host}]" if ":" in options.host else options.host
        print(
            f"replayed chassis ready on ws://{host}:{chassis.port} "
            f"and tcp://{host}:{chassis.tcp_port}",
            flush=True,
        )
        await stopping.wait()


if __name__ == "__main__":
    sys.exit(main())
