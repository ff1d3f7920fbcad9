"""A chassis that answers every request at once with the same message, and pushes PoseSpeed.

    python -m benchmarks.programs.echo_chassis [--beams N] [--transport websocket|tcp]

It runs beside the measured program, so it does as little as it can: it encodes each answer
and each push only once. It prints its port. Each line on stdin is a command:

    delay SECONDS            from now on answer after SECONDS
    push RATE FIRST COUNT    push COUNT messages of PoseSpeed at RATE Hz to all subscribers, with
                             `mileage` counting from FIRST; then print, as JSON, the time of each
                             push (time.monotonic) and the CPU time of all of them, in seconds
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time
from collections.abc import Callable
from functools import cache

from google.protobuf.message import Message

from woosh_robot_agent.link.codecs.choice import JSON, PROTOBUF, server_codec
from woosh_robot_agent.link.codecs.frames import SUBSCRIPTION_TYPE, Codec
from woosh_robot_agent.link.server.base import ServerTransport
from woosh_robot_agent.link.server.tcp import serve_tcp
from woosh_robot_agent.link.server.websocket import serve_websocket
from woosh_robot_agent.link.transport.base import TransportClosedError
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotInfo, ScannerData
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.protos import full_name, message_type

_PLACEHOLDER = 123456789
"""Serial number in a prepared answer, which is replaced by that of the request."""
_BUSY_WAIT = 0.002
"""Time before a push that is spent in `time.sleep`, in seconds: the event loop's timers have a
resolution of only 1 ms."""
_CATCH_UP = 0.005
"""Maximum delay that pushes may catch up on, in seconds. A longer one would cause a burst."""
Answer = Callable[[int], "str | bytes"]
"""Returns the frame that answers the request with a serial number."""


def pose_speed(number: int) -> PoseSpeed:
    """Return a push with its number in `mileage`."""
    message = PoseSpeed(robot_id=1, mileage=number, map_id=3)
    message.pose.x, message.pose.y, message.pose.theta = 4.23276472, -6.6727581, -0.255771846
    message.twist.linear, message.twist.angular = 0.5, 0.1
    return message


def scan(beams: int) -> ScannerData:
    """Return a scan with the given number of beams."""
    step = 4.4 / max(1, beams - 1)
    message = ScannerData(angle_min=-2.2, angle_max=2.2, angle_increment=step, range_max=25.0)
    message.ranges.extend(1.0 + beam % 1080 / 137.0 for beam in range(beams))
    return message


class EchoChassis:
    """Answers every request with a constant message of the request's type.

    Attributes:
        delay: Time from a request to its answer, in seconds.
    """

    def __init__(self, beams: int) -> None:
        self.delay = 0.0
        self._subscribers: dict[ServerTransport, Codec] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        bodies: tuple[Message, ...] = (RobotInfo(robot_id=1), pose_speed(0), scan(beams))
        self._bodies = {full_name(body): body for body in bodies}
        self._answer = cache(self._make_answer)

    async def serve(self, transport: ServerTransport) -> None:
        """Serve one connection until it ends."""
        try:
            while True:
                await self._handle(transport, await transport.recv())
        except TransportClosedError:
            self._subscribers.pop(transport, None)

    async def _handle(self, transport: ServerTransport, frame: str | bytes) -> None:
        codec = server_codec(frame)
        envelope = codec.decode(frame)
        if envelope.type == SUBSCRIPTION_TYPE:
            if full_name(PoseSpeed) in codec.body(envelope, Subscription).topics:
                self._subscribers[transport] = codec
            return
        answer = self._answer(codec, envelope.type)(envelope.sn)
        if self.delay:
            task = asyncio.ensure_future(self._send_later(transport, answer))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        else:
            await transport.send(answer)

    def _make_answer(self, codec: Codec, type_name: str) -> Answer:
        body = self._bodies.get(type_name) or message_type(type_name)()
        return self.answer_with(codec, type_name, body)

    @staticmethod
    def answer_with(codec: Codec, type_name: str, body: Message) -> Answer:
        """Return a function that makes answers with a body."""

        def encode(sn: int) -> str | bytes:
            return codec.encode(type_name, body, sn=sn, ok=True, timestamp=1)

        if codec is PROTOBUF:
            return encode
        before, after = str(encode(_PLACEHOLDER)).split(str(_PLACEHOLDER))
        return lambda sn: f"{before}{sn}{after}"

    async def _send_later(self, transport: ServerTransport, answer: str | bytes) -> None:
        await asyncio.sleep(self.delay)
        await transport.send(answer)

    async def push(self, rate: float, first: int, count: int) -> None:
        """Push PoseSpeed as the command `push` says, and print the report."""
        numbers = range(first, first + count)
        frames = {
            codec: [_push_frame(codec, number) for number in numbers]
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
        for i in range(count):
            sent.append(time.monotonic())
            for transport, prepared in outgoing:
                await transport.send_raw(prepared[i])
            due = max(due + 1 / rate, time.monotonic() - _CATCH_UP)
            await asyncio.sleep(max(0.0, due - time.monotonic() - _BUSY_WAIT))
            time.sleep(max(0.0, due - time.monotonic()))
        print(json.dumps({"sent": sent, "cpu": time.process_time() - cpu}), flush=True)


def _push_frame(codec: Codec, number: int) -> bytes:
    frame = codec.encode(full_name(PoseSpeed), pose_speed(number), timestamp=1)
    return frame.encode() if isinstance(frame, str) else frame


async def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--beams", type=int, default=1080)
    parser.add_argument("--transport", default="websocket")
    options = parser.parse_args()
    chassis = EchoChassis(options.beams)
    serve = serve_tcp if options.transport == "tcp" else serve_websocket
    listener = await serve(chassis.serve, "127.0.0.1", 0, max_size=2**26)
    print(listener.port, flush=True)
    lines = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    while line := await lines.readline():
        command, *words = line.split()
        if command == b"delay":
            chassis.delay = float(words[0])
        else:
            rate, first, count = words
            await chassis.push(float(rate), int(first), int(count))


if __name__ == "__main__":
    asyncio.run(main())
