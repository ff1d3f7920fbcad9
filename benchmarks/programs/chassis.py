"""A chassis that answers every request at once with the same message, and pushes what it is told.

    python -m benchmarks.programs.chassis [--beams N] [--map BYTES] [--transport websocket|tcp]

A map download is answered with a file of BYTES random bytes. A task or a MoveBase is reported as
running, and then as completed. The chassis runs beside the measured program, so it does as little
as it can: it encodes each answer and each push only once. It prints its port. Each line on stdin is
a command:

    delay SECONDS            from now on answer after SECONDS
    move                     from now on push poses at 10 Hz, and answer each ScannerData with
                             another scan
    push RATE FIRST COUNT    push COUNT messages of PoseSpeed at RATE Hz to all subscribers, with
                             `mileage` counting from FIRST; then print, as JSON, the time of each
                             push (time.monotonic) and the CPU time of all of them, in seconds
    push_mix RATE FIRST COUNT
                             the same with several types; see `mixed`
    push_path RATE POSES COUNT
                             push COUNT messages of NavPath with POSES poses at RATE Hz to all
                             subscribers, while it obeys further commands; prints nothing
    goals                    print, as JSON, the time at which each task and each MoveBase since the
                             last such command came, and the time of its last report
                             (time.monotonic), by the id of the task or the x of the pose
    velocities               print, as JSON, the linear velocity in each woosh.robot.Twist since the
                             last such command, and the time of its arrival (time.monotonic)
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import os
import selectors
import sys
import time
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from contextlib import suppress
from functools import cache, partial
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link.codecs import JSON, PROTOBUF, server_codec
from woosh_robot_agent.link.frames import SUBSCRIPTION_TYPE, Codec
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_agent.link.server import ServerTransport, serve_tcp, serve_websocket
from woosh_robot_agent.link.transport import TransportClosedError
from woosh_robot_agent.pb.map.map_pack_pb2 import Download, DownloadResponse
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask, Twist
from woosh_robot_agent.pb.robot.robot_pb2 import (
    NavPath,
    PoseSpeed,
    RobotInfo,
    ScannerData,
    TaskProc,
)
from woosh_robot_agent.pb.ros.action_pb2 import MoveBase
from woosh_robot_agent.pb.ros.ros_pack_pb2 import (
    CallAction,
    Feedback,
    Feedbacks,
    kRosExecuting,
    kRosSuccess,
)
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson, Subscription
from woosh_robot_agent.pb.util.task_pb2 import kCompleted, kExecuting

_PLACEHOLDER = 123456789
"""Serial number in a prepared answer, which is replaced by that of the request."""
_BUSY_WAIT = 0.002
"""Time before a push that is spent in `time.sleep`, in seconds: the event loop's timers have a
resolution of only 1 ms."""
_CATCH_UP = 0.005
"""Maximum delay that pushes may catch up on, in seconds. A longer one would cause a burst."""
_LARGE = 1024 * 1024
"""Size from which an answer is written as its parts, without a copy of the whole, in bytes."""
_VARIANTS = 20
"""Number of different scans of a robot that moves."""
_MOVE_PERIOD = 0.1
"""Time between two poses of a robot that moves, in seconds."""
_FIRST_REPORT = 0.02
"""Delay of the first report on a goal after the answer, in seconds."""
_DURATION = 0.15
"""Time from the first report on a goal to the last one, in seconds."""
Send = Callable[[ServerTransport, int], Awaitable[None]]
"""Sends the answer to the request with a serial number."""


def pose_speed(number: int) -> PoseSpeed:
    """Return a push with its number in `mileage`."""
    message = PoseSpeed(robot_id=1, mileage=number, map_id=3)
    message.pose.x, message.pose.y, message.pose.theta = 4.23276472, -6.6727581, -0.255771846
    message.twist.linear, message.twist.angular = 0.5, 0.1
    return message


def scan(beams: int, farther: float = 0.0) -> ScannerData:
    """Return a scan with the given number of beams, and everything farther away by some metres."""
    step = 4.4 / max(1, beams - 1)
    message = ScannerData(angle_min=-2.2, angle_max=2.2, angle_increment=step, range_max=25.0)
    message.ranges.extend(1.0 + farther + beam % 1080 / 137.0 for beam in range(beams))
    return message


def mixed(number: int, beams: int) -> Message:
    """Return a push with its number: of 100 pushes one is a scan, ten are status codes.

    The number is in `mileage` of PoseSpeed, `robot_id` of ScannerData and `time` of StatusCode.
    """
    if number % 100 == 0:
        message = scan(beams)
        message.robot_id = number
        return message
    if number % 10 == 1:
        text = "导航未启动"  # robots send their texts in Chinese
        return StatusCode(robot_id=1, code=140801000071, time=number, msg=text)
    return pose_speed(number)


def long_path(poses: int) -> NavPath:
    """Return a path with the given number of poses."""
    message = NavPath(robot_id=1)
    for i in range(poses):
        message.path.poses.add(x=4.23276472 + i / 100, y=-6.6727581, theta=-0.255771846)
    return message


def map_files(size: int) -> DownloadResponse:
    """Return a scene with one file of the given size, which cannot be compressed."""
    message = DownloadResponse()
    message.file_datas.add(name="map.png", data=os.urandom(size))
    return message


class BenchChassis:
    """Answers every request with a constant message of the request's type.

    Attributes:
        beams: number of beams of a scan.
        delay: time from a request to its answer, in seconds.
        goals: time of arrival and time of the last report of each task and each MoveBase, by the id
            of the task or the x of the pose.
        velocities: linear velocity and time of arrival of each velocity command.
    """

    def __init__(self, beams: int, map_size: int) -> None:
        self.beams = beams
        self.delay = 0.0
        self.goals: dict[int, tuple[float, float]] = {}
        self.velocities: list[tuple[float, float]] = []
        self._moving = False
        self._subscribers: dict[ServerTransport, Codec] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._reports: set[asyncio.Task[None]] = set()
        """The tasks that report on goals."""
        bodies: tuple[Message, ...] = (RobotInfo(robot_id=1), pose_speed(0), scan(beams))
        self._bodies = {full_name(body): body for body in bodies}
        self._bodies[full_name(Download)] = map_files(map_size)
        self._sender = cache(self._make_sender)

    async def serve(self, transport: ServerTransport) -> None:
        """Serve one connection until it ends."""
        try:
            while True:
                await self._handle(transport, await transport.recv())
        except TransportClosedError:
            self._subscribers.pop(transport, None)

    async def _handle(self, transport: ServerTransport, frame: str | bytes) -> None:
        arrival = time.monotonic()
        codec = server_codec(frame)
        envelope = codec.decode(frame)
        if envelope.type == SUBSCRIPTION_TYPE:
            if full_name(PoseSpeed) in codec.body(envelope, Subscription).topics:
                self._subscribers[transport] = codec
            return
        if envelope.type == full_name(Twist):
            self.velocities.append((codec.body(envelope, Twist).linear, arrival))
        send = self._sender(codec, envelope.type)
        if self.delay:
            self._run_in_background(self._send_later(send, transport, envelope.sn))
        else:
            await send(transport, envelope.sn)
        if envelope.type == full_name(ExecTask):
            task_id = codec.body(envelope, ExecTask).task_id
            reports: list[Message] = [
                TaskProc(robot_task_id=task_id, state=state) for state in (kExecuting, kCompleted)
            ]
            self._report(transport, codec, task_id, reports, arrival)
        if envelope.type == full_name(CallAction):  # of MoveBase, the only action that is measured
            number = int(codec.body(envelope, CallAction).move_base.target_pose.x)
            reports = [
                Feedbacks(fbs=[Feedback(action=full_name(MoveBase), state=state)])
                for state in (kRosExecuting, kRosSuccess)
            ]
            self._report(transport, codec, number, reports, arrival)

    async def take_goals(self) -> dict[int, tuple[float, float]]:
        """Return `goals` when all of them have ended, and forget them."""
        if self._reports:
            await asyncio.wait(self._reports)
        taken, self.goals = self.goals, {}
        return taken

    def _report(
        self,
        transport: ServerTransport,
        codec: Codec,
        number: int,
        reports: Sequence[Message],
        arrival: float,
    ) -> None:
        first, last = (_frame(codec, each) for each in reports)

        async def report() -> None:
            await asyncio.sleep(_FIRST_REPORT)
            await transport.send(first)
            await asyncio.sleep(_DURATION)
            self.goals[number] = (arrival, time.monotonic())
            await transport.send(last)

        task = self._run_in_background(report())
        self._reports.add(task)
        task.add_done_callback(self._reports.discard)

    def _run_in_background(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _make_sender(self, codec: Codec, type_name: str) -> Send:
        if self._moving and type_name == full_name(ScannerData):
            scans = (scan(self.beams, 0.01 * number) for number in range(_VARIANTS))
            turn = itertools.cycle([self._sender_of(codec, each) for each in scans])
            return lambda transport, sn: next(turn)(transport, sn)
        return self._sender_of(codec, self._bodies.get(type_name) or message_type(type_name)())

    @staticmethod
    def _sender_of(codec: Codec, body: Message) -> Send:
        """Return a function that sends an answer with the given body."""

        def encode(sn: int) -> str | bytes:
            return codec.encode(full_name(body), body, sn=sn, ok=True, timestamp=1)

        if body.ByteSize() >= _LARGE:
            return _in_parts(codec, encode)
        if codec is PROTOBUF:
            return lambda transport, sn: transport.send(encode(sn))
        before, after = str(encode(_PLACEHOLDER)).split(str(_PLACEHOLDER))
        return lambda transport, sn: transport.send(f"{before}{sn}{after}")

    async def _send_later(self, send: Send, transport: ServerTransport, sn: int) -> None:
        await asyncio.sleep(self.delay)
        await send(transport, sn)

    def move(self) -> None:
        """Start to move, as the command `move` says."""

        async def push_poses() -> None:
            for number in itertools.count():
                message = pose_speed(number)
                message.pose.x += 0.01 * (number % 100)
                for transport, codec in list(self._subscribers.items()):
                    with suppress(TransportClosedError):  # a subscriber has left
                        await transport.send(_frame(codec, message))
                await asyncio.sleep(_MOVE_PERIOD)

        self._moving = True
        self._sender.cache_clear()
        self._run_in_background(push_poses())

    def start_pushing_paths(self, rate: float, poses: int, count: int) -> None:
        """Start to push a long path as the command `push_path` says."""
        frames = {
            transport: _frame(codec, long_path(poses))
            for transport, codec in self._subscribers.items()
        }

        async def push() -> None:
            for _ in range(count):
                for transport, frame in frames.items():
                    await transport.send(frame)
                await asyncio.sleep(1 / rate)

        self._run_in_background(push())

    async def push(self, rate: float, messages: Sequence[Message]) -> None:
        """Push messages as the command `push` says, and print the report."""
        frames = {
            codec: [_as_bytes(_frame(codec, message)) for message in messages]
            for codec in set(self._subscribers.values())
        }
        # encoded beforehand, so that encoding is not part of the measurement
        outgoing = [
            (transport, [transport.header(len(f), text=codec is JSON) + f for f in frames[codec]])
            for transport, codec in self._subscribers.items()
        ]
        sent = []
        cpu = time.process_time()
        due = time.monotonic()
        for i in range(len(messages)):
            sent.append(time.monotonic())
            for transport, prepared in outgoing:
                with suppress(TransportClosedError):  # a subscriber has left
                    await transport.send_raw(prepared[i])
            due = max(due + 1 / rate, time.monotonic() - _CATCH_UP)
            await asyncio.sleep(max(0.0, due - time.monotonic() - _BUSY_WAIT))
            time.sleep(max(0.0, due - time.monotonic()))
        print(json.dumps({"sent": sent, "cpu": time.process_time() - cpu}), flush=True)


def _in_parts(codec: Codec, encode: Callable[[int], str | bytes]) -> Send:
    """Return a function that sends a large answer without encoding or copying it again."""
    if codec is PROTOBUF:
        before, after = bytes(encode(0)), b""  # type: ignore[arg-type]  # protobuf frames are bytes
    else:
        text = str(encode(_PLACEHOLDER)).encode()
        before, _, after = text.rpartition(str(_PLACEHOLDER).encode())

    async def send(transport: ServerTransport, sn: int) -> None:
        # protobuf merges the fields of two messages that follow each other
        number = MessagePackJson(sn=sn).SerializeToString() if codec is PROTOBUF else b"%d" % sn
        end = number + after
        await transport.send_raw(transport.header(len(before) + len(end), text=codec is JSON))
        await transport.send_raw(before)
        await transport.send_raw(end)

    return send


def _frame(codec: Codec, message: Message) -> str | bytes:
    return codec.encode(full_name(message), message, timestamp=1)


def _as_bytes(frame: str | bytes) -> bytes:
    return frame.encode() if isinstance(frame, str) else frame


async def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--beams", type=int, default=1080)
    parser.add_argument("--map", type=int, default=0)
    parser.add_argument("--transport", default="websocket")
    options = parser.parse_args()
    chassis = BenchChassis(options.beams, options.map)
    serve = serve_tcp if options.transport == "tcp" else serve_websocket
    # robots of one process need different addresses: 127.0.0.1, 127.0.0.2, ...
    listener = await serve(chassis.serve, "0.0.0.0", 0, max_size=2**26)
    print(listener.port, flush=True)
    lines = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    while line := await lines.readline():
        command, *words = line.decode().split()
        if command == "delay":
            chassis.delay = float(words[0])
        elif command == "move":
            chassis.move()
        elif command == "goals":
            print(json.dumps(await chassis.take_goals()), flush=True)
        elif command == "velocities":
            print(json.dumps(chassis.velocities), flush=True)
            chassis.velocities = []
        elif command == "push_path":
            chassis.start_pushing_paths(float(words[0]), int(words[1]), int(words[2]))
        else:
            rate, first, count = words
            numbers = range(int(first), int(first) + int(count))
            make = partial(mixed, beams=chassis.beams) if command == "push_mix" else pose_speed
            await chassis.push(float(rate), [make(number) for number in numbers])


if __name__ == "__main__":
    # `select` waits exactly; the default selector rounds timeouts up to milliseconds, so that the
    # answers of `delay` would be late
    asyncio.SelectorEventLoop(selectors.SelectSelector()).run_until_complete(main())
