"""The program `record`, which writes all frames between a robot and its clients to a file."""

from __future__ import annotations

import argparse
import asyncio
import logging
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.endpoints import NAMESPACE, QUERIES, TOPICS
from woosh_robot_agent.link import (
    ChassisClient,
    ConnectionLostError,
    LinkConfig,
    LinkError,
    LinkState,
)
from woosh_robot_agent.link.config import MIB, url_host
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_agent.link.reports import log_to_stderr, printable
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.program import import_problem
from woosh_robot_agent.tools.options import (
    ToolError,
    above_zero,
    add_link_options,
    host_and_port,
    link_arguments,
    link_config,
    run_tool,
    stop_event,
    tool_parser,
    warn_if_not_local,
)
from woosh_robot_agent.tools.recording.files import Limits
from woosh_robot_agent.tools.recording.proxy import READ_PERIOD, RecordingProxy
from woosh_robot_agent.tools.recording.writer import RecordingWriter

if TYPE_CHECKING:  # needs ROS
    from woosh_robot_agent.tools.recording.ros_recorder import RosRecorder

_LOG = logging.getLogger(__name__)
_LOCALHOST = "127.0.0.1"
_OWN_READ_PERIOD = 0.02
"""Minimum average time between two reads without --listen, when no client waits, in seconds."""
_MAX_LOSSES = 2
"""Number of connections lost in a row during a type of query after which it is not sent again."""
_EPILOG = """\
With --listen, record is a proxy between the agent and the robot: connect the
agent to it, and all traffic is recorded, commands included.
Without --listen, record connects to the robot by itself, subscribes to
everything and sends each query once. It never commands the robot.

The file is MCAP, which Foxglove, Lichtblick and PlotJuggler open. With --ros,
a second file has what the agent publishes; rosbag2 plays that one.

Ctrl-C ends the recording."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Record until SIGINT, SIGTERM or SIGHUP, or for the time of `--duration`.

    Returns:
        The exit status. 1 if the recording could not start or ended early, if frames or ROS
        messages were lost, or if none came: no frame of the robot, or with `--ros` no ROS message.
        Otherwise 0.
    """
    parser = make_parser()
    options = parser.parse_args(arguments)
    config = link_config(parser, options)
    log_to_stderr(logging.INFO, "%(message)s")
    return run_tool(_run(config, options))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = tool_parser("record", "Record all frames between a robot and its clients.", _EPILOG)
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
        type=_mebibytes,
        default=1024 * MIB,
        help="size of all files together at which the recording ends, in MiB, and again of those "
        "of --ros (default: 1024)",
    )
    parser.add_argument(
        "--split-size",
        type=_mebibytes,
        default=0,
        help="size after which the next file begins, in MiB (default: one file)",
    )
    parser.add_argument(
        "--split-duration",
        type=above_zero,
        default=0.0,
        help="duration after which the next file begins, in seconds (default: one file)",
    )
    parser.add_argument(
        "--duration",
        type=above_zero,
        help="duration of the recording, in seconds (default: no limit)",
    )
    parser.add_argument(
        "--ros",
        nargs="?",
        const=NAMESPACE,
        metavar="NAMESPACE",
        help="also record what the agent in this namespace publishes, in a file whose name ends in "
        "_ros (default: %(const)s)",
    )
    parser.add_argument(
        "--no-large",
        action="store_true",
        help="without --listen: leave out laser scans and growing maps, which are large",
    )
    return parser


def _mebibytes(text: str) -> int:
    """Parse a number of MiB; return the number of bytes."""
    size = above_zero(text) * MIB
    if not 1 <= size < math.inf:
        raise argparse.ArgumentTypeError(f"must be at least one byte, in MiB: {text}")
    return int(size)


class PassiveClient:
    """A client that subscribes to all pushes and sends each query once per connection.

    A query during which `_MAX_LOSSES` connections were lost is not sent again. The client discards
    everything that it receives, because the proxy records the frames.

    Args:
        config: configuration of the link to the proxy.
        with_large: True to subscribe also to large pushes: laser scans and growing maps.
    """

    def __init__(self, config: LinkConfig, *, with_large: bool = True) -> None:
        self._chassis = ChassisClient(config=config)
        self._chassis.on_snapshot(self._on_snapshot)
        self._scene = ""
        """Name of the current scene, for the request of its maps; empty if unknown."""
        for topic in TOPICS:
            if with_large or not topic.on_demand:
                self._chassis.subscribe_raw(message_type(topic.push), lambda _: None)
        self._chassis.subscribe_raw(Feedbacks, lambda _: None)
        self._chassis.on_state(self._on_state)
        self._queries: asyncio.Task[None] | None = None
        self._losses: Counter[str] = Counter()
        """Number of connections lost in a row during a query, by the type of the query.

        It is raised before the query is sent, and lowered or reset if the connection lasts.
        """

    def start(self) -> None:
        """Connect, and reconnect whenever the connection is lost."""
        self._chassis.start()

    async def close(self) -> None:
        """Disconnect."""
        self._cancel_queries()
        await self._chassis.close()

    def _on_state(self, state: LinkState) -> None:
        self._cancel_queries()
        if state is LinkState.READY:
            self._queries = asyncio.get_running_loop().create_task(self._query_all())

    def _on_snapshot(self, info: RobotInfo) -> None:
        self._scene = info.scene.scene_name

    def _cancel_queries(self) -> None:
        if self._queries is not None:
            self._queries.cancel()

    async def _query_all(self) -> None:
        """Send each query, one after the other, so that `replay` can answer it."""
        make = RequestMaker(self._chassis.config.robot_id)
        names = dict.fromkeys(query.request for query in QUERIES)
        requests = [make.empty(message_type(name)) for name in names]
        if self._scene:
            requests.append(make.address(SceneData(name=self._scene)))  # its answer has the maps
        for request in requests:
            name = full_name(request)
            if self._losses[name] >= _MAX_LOSSES:  # perhaps it makes the robot end the connection
                continue
            self._losses[name] += 1  # in advance: a lost connection may cancel this task
            try:
                await self._chassis.request(request)
            except LinkError as error:
                _LOG.info("query %s failed: %s", name, error)
                if isinstance(error, ConnectionLostError):
                    return
                self._losses[name] -= 1  # the connection was not lost
            else:
                self._losses[name] = 0


async def _run(config: LinkConfig, options: argparse.Namespace) -> int:
    """Record until a signal or the end of `--duration`; return the exit status.

    Raises:
        ToolError: the recording cannot start.
    """
    stop, loop = stop_event(), asyncio.get_running_loop()

    def on_early_end(what: str, reason: str) -> None:
        # An agent that is connected through the proxy needs it even without a recording.
        more = "; the proxy keeps running" if options.listen and not stop.is_set() else ""
        # not by `print`, which fails if stderr is a file on the full disk
        _LOG.error("error: the recording of %s has ended: %s%s", what, reason, more)
        if not options.listen:
            loop.call_soon_threadsafe(stop.set)

    limits = Limits(options.max_size, options.split_size, options.split_duration)
    try:
        writer = RecordingWriter(
            options.output, config.address, limits, partial(on_early_end, "frames")
        )
    except OSError as error:
        raise ToolError(_cannot_create(error)) from None
    read_period = READ_PERIOD if options.listen else _OWN_READ_PERIOD
    proxy = RecordingProxy(config, writer, read_period)
    ros_recorder = None
    async with AsyncExitStack() as stack:
        stack.callback(writer.close)
        host, port = options.listen or (_LOCALHOST, 0)
        try:
            port = await _listen(proxy, host, port)
            stack.push_async_callback(proxy.stop)
            if options.ros:
                ros_recorder = _start_ros(
                    options, limits, partial(on_early_end, "ROS messages"), writer.now
                )
                stack.callback(ros_recorder.close)
        except ToolError:
            writer.discard()  # an empty file would block the next attempt
            raise
        if options.listen:
            warn_if_not_local(host, "can command the robot")
            _print_instructions(config, host, port, writer.files.paths[0])
        else:
            print(f"recording {config.address} to {writer.files.paths[0]}", flush=True)
            # The proxy logs problems of the robot; the log of this client would repeat them.
            link_log = logging.getLogger("woosh_robot_agent.link")
            stack.callback(link_log.setLevel, link_log.level)
            link_log.setLevel(logging.ERROR)
            own = replace(config, ip=_LOCALHOST, port=port)
            client = PassiveClient(own, with_large=not options.no_large)
            stack.push_async_callback(client.close)
            client.start()
        await asyncio.wait({asyncio.ensure_future(stop.wait())}, timeout=options.duration)
        stop.set()  # for `on_early_end`, if the time of --duration is over
    failed = _report_frames(writer, config, options)
    if ros_recorder is not None:
        failed |= _report_ros(ros_recorder, options.ros)
    return int(failed)


async def _listen(proxy: RecordingProxy, host: str, port: int) -> int:
    """Start the proxy; return its port. Raise `ToolError` if it cannot listen."""
    try:
        return await proxy.start(host, port)
    except OSError as error:
        reason = error.strerror or error
        raise ToolError(f"cannot listen on {host}, port {port}: {reason}") from None


def _start_ros(
    options: argparse.Namespace,
    limits: Limits,
    on_early_end: Callable[[str], None],
    now: Callable[[], int],
) -> RosRecorder:
    """Start the recording of ROS topics. Raise `ToolError` if that is not possible."""
    try:
        from woosh_robot_agent.tools.recording.ros_recorder import RosRecorder
    except ImportError as error:
        if not (problem := import_problem(error)):
            raise
        raise ToolError(f"--ros: {problem}") from None
    output = options.output
    path = output.with_name(f"{output.stem}_ros{output.suffix}")
    try:
        return RosRecorder(options.ros, path, limits, on_early_end, now)
    except OSError as error:
        raise ToolError(_cannot_create(error)) from None
    except Exception as error:  # rclpy raises many types for invalid names and arguments
        raise ToolError(f"--ros {options.ros}: {' '.join(str(error).split())}") from None


def _report_frames(
    writer: RecordingWriter, config: LinkConfig, options: argparse.Namespace
) -> bool:
    """Print the result of the recording of frames; return True if something is missing."""
    if writer.frames:
        print(
            f"recorded {writer.frames} frames of {writer.connections} connection"
            f"{'s' * (writer.connections != 1)} to {_names(writer.files.paths)}"
        )
    had_client = bool(writer.connections or writer.refusal)
    if writer.lost:
        print(f"error: frames that passed but are not recorded: {writer.lost}", file=sys.stderr)
    elif options.listen and not had_client:
        print(
            "error: nothing was recorded: no client connected to the address of --listen",
            file=sys.stderr,
        )
    elif not writer.answered:
        if writer.connections:
            problem = "the connection was accepted, but no frame came; check --ip and --transport"
        else:
            problem = f"{writer.refusal}; check that it is switched on and in this network"
        hint = f"run `doctor {link_arguments(config)}` to find the cause"
        print(
            printable(f"error: no robot answered at {config.address}: {problem}, or {hint}"),
            file=sys.stderr,
        )
    return writer.files.failed or bool(writer.lost) or not writer.answered


def _report_ros(recorder: RosRecorder, namespace: str) -> bool:
    """Print the result of the recording of ROS topics; return True if something is missing."""
    print(f"recorded {recorder.messages} ROS messages to {_names(recorder.files.paths)}")
    for topic, lost in recorder.lost.items():
        # A publisher with a short queue may have replaced messages before they were sent.
        print(f"error: messages on {topic} that the middleware lost: {lost}", file=sys.stderr)
    if not recorder.messages:
        print(
            "error: no ROS message was recorded: check that the agent is running, that it has the "
            f"same ROS_DOMAIN_ID, and that its namespace is that of --ros: {namespace}",
            file=sys.stderr,
        )
    return recorder.files.failed or bool(recorder.lost) or not recorder.messages


def _cannot_create(error: OSError) -> str:
    remedy = "; choose another name with --output" if isinstance(error, FileExistsError) else ""
    return f"cannot create {error.filename}: {error.strerror}{remedy}"


def _names(paths: Sequence[Path]) -> str:
    if len(paths) == 1:
        return str(paths[0])
    return f"{len(paths)} files, {paths[0]} to {paths[-1]}"


def _print_instructions(config: LinkConfig, host: str, port: int, path: Path) -> None:
    """Print how to connect the agent to the proxy at `host` and `port`."""
    parameters = {"ip": host, "port": port, "transport": config.transport}
    for name in ("encoding", "robot_id"):
        if getattr(config, name) != getattr(LinkConfig, name):
            parameters[name] = getattr(config, name)
    arguments = " ".join(f"-p {name}:={value}" for name, value in parameters.items())
    print(
        f"recording {config.address} to {path}; connect the agent to {url_host(host)}:{port}, "
        "e.g. with\n"
        f"  ros2 run woosh_robot_agent agent --ros-args -r __ns:={NAMESPACE} {arguments}",
        flush=True,
    )
