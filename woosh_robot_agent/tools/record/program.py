"""Command line of `record`."""

from __future__ import annotations

import argparse
import asyncio
import logging
import math
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from woosh_robot_agent.endpoints import NAMESPACE
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.config import MIB
from woosh_robot_agent.link.reports import log_to_stderr, printable
from woosh_robot_agent.program import exit_on_stdout_error, import_problem
from woosh_robot_agent.tools.options import (
    add_link_options,
    host_and_port,
    link_arguments,
    link_config,
    stop_event,
    warn_if_not_local,
)
from woosh_robot_agent.tools.recording.records import RecordingError, require_libraries

if TYPE_CHECKING:  # needs the libraries, unlike --help
    from woosh_robot_agent.tools.record.ros_recorder import RosRecorder
    from woosh_robot_agent.tools.recording.files import Limits
    from woosh_robot_agent.tools.recording.writer import RecordingWriter

_LOCALHOST = "127.0.0.1"
_OWN_READ_PERIOD = 0.02
"""Time between two reads at high rates if there is no client that would wait, in seconds."""
_EPILOG = """\
With --listen, record is a proxy between the agent and the robot: connect the
agent to it, and all traffic is recorded, commands included.
Without --listen, record connects to the robot by itself, subscribes to
everything and sends each query once. It never commands the robot.

The file is MCAP, which Foxglove, Lichtblick and PlotJuggler open. With --ros,
a second file has what the agent publishes; rosbag2 plays that one.

Ctrl-C ends the recording."""


@exit_on_stdout_error
def main(arguments: Sequence[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM.

    Args:
        arguments: Arguments of the program; by default those of the command line.

    Returns:
        The exit status: 0, or 1 if the program could not listen, the recording ended early,
        nothing was recorded, or frames or ROS messages were lost.
    """
    parser = _make_parser()
    options = parser.parse_args(arguments)
    config = link_config(parser, options)
    for name in ("max_size", "split_size", "duration", "split_duration"):
        _check_limit(parser, options, name)
    log_to_stderr(logging.INFO, "%(message)s")
    try:
        require_libraries()
        return asyncio.run(_run(config, options))
    except (OSError, RecordingError) as error:
        print(printable(f"error: {error}"), file=sys.stderr)
        return 1


def _make_parser() -> argparse.ArgumentParser:
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
        default=Path(time.strftime("recording-%Y%m%d-%H%M%S.mcap")),
        help="file to create; it must not exist (default: recording-DATE-TIME.mcap)",
    )
    parser.add_argument(
        "--max-size",
        type=float,
        default=1024.0,
        help="maximum size of all files together, in MiB; reaching it ends the recording "
        "(default: %(default)g)",
    )
    parser.add_argument(
        "--split-size",
        type=float,
        help="size after which the next file begins, in MiB (default: one file)",
    )
    parser.add_argument(
        "--split-duration",
        type=float,
        help="duration after which the next file begins, in seconds (default: one file)",
    )
    parser.add_argument(
        "--duration", type=float, help="duration of the recording, in seconds (default: no limit)"
    )
    parser.add_argument(
        "--ros",
        nargs="?",
        const=NAMESPACE,
        metavar="NAMESPACE",
        help="also record what the agent in this namespace publishes, in a file of its own whose "
        "name ends in _ros; the limits apply to it, too (default namespace: %(const)s)",
    )
    parser.add_argument(
        "--no-large",
        action="store_true",
        help="without --listen: do not subscribe to laser scans and growing maps, which are large",
    )
    return parser


def _check_limit(parser: argparse.ArgumentParser, options: argparse.Namespace, name: str) -> None:
    """End the program if the value of an option is not a possible limit."""
    value, option = getattr(options, name), f"--{name.replace('_', '-')}"
    if value is None:
        return
    if not 0 < value < math.inf:
        parser.error(f"{option} must be a finite number above 0: {value}")
    if name.endswith("_size") and value * MIB < 1:
        parser.error(f"{option} must be at least one byte, in MiB: {value}")


async def _run(config: LinkConfig, options: argparse.Namespace) -> int:
    from woosh_robot_agent.tools.record.passive_client import PassiveClient
    from woosh_robot_agent.tools.record.proxy import RecordingProxy
    from woosh_robot_agent.tools.recording.files import Limits
    from woosh_robot_agent.tools.recording.writer import RecordingWriter

    stop = stop_event()
    loop = asyncio.get_running_loop()

    def on_early_end(reason: str) -> None:
        # An agent that is connected through the proxy needs it even without a recording.
        more = "; the proxy keeps running" if options.listen else ""
        print(f"error: the recording has ended: {reason}{more}", file=sys.stderr, flush=True)
        if not options.listen:
            loop.call_soon_threadsafe(stop.set)

    limits = Limits(
        int(options.max_size * MIB),
        int((options.split_size or 0) * MIB),
        options.split_duration or 0.0,
    )
    try:
        writer = RecordingWriter(options.output, config.address, limits, on_early_end)
    except OSError as error:
        raise RecordingError(_cannot_create(error)) from None
    ros_recorder = None
    try:
        if options.listen:
            proxy = RecordingProxy(config, writer)
        else:
            proxy = RecordingProxy(config, writer, _OWN_READ_PERIOD)
        host, port = options.listen or (_LOCALHOST, 0)
        async with AsyncExitStack() as stack:
            try:
                port = await proxy.start(host, port)
                stack.push_async_callback(proxy.stop)
                if options.ros:
                    ros_recorder = _start_ros(options, limits, on_early_end)
            except (OSError, RecordingError):
                writer.discard()  # it is empty, and would block the next attempt
                raise
            if options.listen:
                warn_if_not_local(host, "can command the robot")
                _print_instructions(config, host, port, writer.paths[0])
            else:
                print(f"recording {config.address} to {writer.paths[0]}", flush=True)
                own = replace(config, ip=_LOCALHOST, port=port)
                # The proxy logs what concerns the robot; this client knows only the proxy.
                logging.getLogger("woosh_robot_agent.link").setLevel(logging.ERROR)
                client = PassiveClient(own, with_large=not options.no_large)
                stack.push_async_callback(client.close)
                client.start()
            await _wait(stop, options.duration)
    finally:
        writer.close()
        if ros_recorder is not None:
            ros_recorder.close()
    failed = _report_frames(writer, config, options)
    if ros_recorder is not None:
        failed |= _report_ros(ros_recorder, options.ros)
    return int(failed)


def _start_ros(
    options: argparse.Namespace, limits: Limits, on_early_end: Callable[[str], None]
) -> RosRecorder:
    try:
        from woosh_robot_agent.tools.record.ros_recorder import RosRecorder
    except ImportError as error:
        if not (problem := import_problem(error)):
            raise
        raise RecordingError(f"--ros: {problem}") from None
    output = options.output
    path = output.with_name(f"{output.stem}_ros{output.suffix}")
    try:
        return RosRecorder(options.ros, path, limits, on_early_end)
    except OSError as error:
        raise RecordingError(_cannot_create(error)) from None
    except Exception as error:  # rclpy has many for invalid names and arguments
        raise RecordingError(f"--ros {options.ros}: {error}") from None


def _report_frames(
    writer: RecordingWriter, config: LinkConfig, options: argparse.Namespace
) -> bool:
    """Print the result of a recording; return True if something is missing."""
    if writer.frames:
        print(
            f"recorded {writer.frames} frames of {writer.connections} connections to "
            f"{_names(writer.paths)}"
        )
    if writer.lost:
        print(f"error: frames that passed but are not recorded: {writer.lost}", file=sys.stderr)
    elif options.listen and not (writer.connections or writer.refusal):
        print(
            "error: nothing was recorded: no client connected to the address of --listen",
            file=sys.stderr,
        )
    elif not writer.answered:
        if writer.connections:
            problem = "the connection was accepted, but no frame came; check --port and --transport"
        else:
            problem = f"{writer.refusal}; check that it is switched on and in this network"
        hint = f"run `doctor {link_arguments(config)}` to find the cause"
        print(
            printable(f"error: no robot answered at {config.address}: {problem}, or {hint}"),
            file=sys.stderr,
        )
    return writer.failed or bool(writer.lost) or not writer.answered


def _report_ros(recorder: RosRecorder, namespace: str) -> bool:
    """Print the result of the recording of ROS topics; return True if something is missing."""
    print(f"recorded {recorder.messages} ROS messages to {_names(recorder.paths)}")
    for topic, lost in recorder.lost.items():
        # A publisher with a short queue may have replaced them before they were sent.
        print(f"error: messages on {topic} that the middleware lost: {lost}", file=sys.stderr)
    if not recorder.messages:
        print(
            "error: no ROS message was recorded: check that the agent is running, that it has the "
            f"same ROS_DOMAIN_ID, and that its namespace is that of --ros: {namespace}",
            file=sys.stderr,
        )
    return recorder.failed or bool(recorder.lost) or not recorder.messages


def _cannot_create(error: OSError) -> str:
    return f"cannot create {error.filename}: {error.strerror}"


def _names(paths: Sequence[Path]) -> str:
    if len(paths) < 2:
        return str(paths[0])
    return f"{len(paths)} files, {paths[0]} to {paths[-1]}"


def _print_instructions(config: LinkConfig, host: str, port: int, path: Path) -> None:
    print(
        f"recording {config.address} to {path}; connect the agent to {host}:{port}, e.g. with\n"
        f"  ros2 run woosh_robot_agent agent --ros-args -r __ns:=/woosh_robot "
        f"-p ip:={host} -p port:={port} -p transport:={config.transport}"
        + "".join(
            f" -p {name}:={getattr(config, name)}"
            for name in ("encoding", "robot_id")
            if getattr(config, name) != getattr(LinkConfig, name)
        ),
        flush=True,
    )


async def _wait(stop: asyncio.Event, duration: float | None) -> None:
    await asyncio.wait({asyncio.ensure_future(stop.wait())}, timeout=duration)
