"""A chassis that answers at once with the same, and pushes PoseSpeed: the other end of a bench.

    python -m benchmarks.echo_chassis [--beams N] [--transport websocket|tcp]

It does as little as it can, for it shares the machine with what is measured: each answer and each
push is encoded once. It prints its port. Each line on its standard input is a command:

    delay S                  answer so many s later from now on
    push RATE FIRST COUNT    push so many PoseSpeed at so many Hz to all who subscribed, `mileage`
                             counting from FIRST; prints, as JSON, when each was sent
                             (time.monotonic, s) and the CPU time in s that this took
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

_SN = 123456789
"""Stands in an answer's text for the number of the request."""
_FINE = 0.002
"""s before a push from when on it waits exactly: the loop's own timers are good to 1 ms."""
_MADE_UP = 0.005
"""s that a row of pushes may catch up on; more at a time would be a burst, another measurement."""
Answer = Callable[[int], "str | bytes"]


def pose_speed(number: int) -> PoseSpeed:
    """A push, of which `mileage` tells it from all others."""
    message = PoseSpeed(robot_id=1, mileage=number, map_id=3)
    message.pose.x, message.pose.y, message.pose.theta = 4.23276472, -6.6727581, -0.255771846
    message.twist.linear, message.twist.angular = 0.5, 0.1
    return message


def scan(beams: int) -> ScannerData:
    """A scan with so many beams."""
    step = 4.4 / max(1, beams - 1)
    message = ScannerData(angle_min=-2.2, angle_max=2.2, angle_increment=step, range_max=25.0)
    message.ranges.extend(1.0 + beam % 1080 / 137.0 for beam in range(beams))
    return message


class EchoChassis:
    """Answers every request with a message of its type, always the same."""

    def __init__(self, beams: int) -> None:
        self.delay = 0.0
        self._subscribers: dict[ServerTransport, Codec] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        values: tuple[Message, ...] = (RobotInfo(robot_id=1), pose_speed(0), scan(beams))
        self._values = {full_name(each): each for each in values}
        self._answer = cache(self._make_answer)

    async def serve(self, transport: ServerTransport) -> None:
        try:
            while True:
                await self._take(transport, await transport.recv())
        except TransportClosedError:
            self._subscribers.pop(transport, None)

    async def _take(self, transport: ServerTransport, frame: str | bytes) -> None:
        codec = server_codec(frame)
        envelope = codec.decode(frame)
        if envelope.type == SUBSCRIPTION_TYPE:
            if full_name(PoseSpeed) in codec.body(envelope, Subscription).topics:
                self._subscribers[transport] = codec
            return
        answer = self._answer(codec, envelope.type)(envelope.sn)
        if self.delay:
            task = asyncio.ensure_future(self._later(transport, answer))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        else:
            await transport.send(answer)

    def _make_answer(self, codec: Codec, type_name: str) -> Answer:
        body = self._values.get(type_name) or message_type(type_name)()

        def encoded(sn: int) -> str | bytes:
            return codec.encode(type_name, body, sn=sn, ok=True, timestamp=1)

        if codec is PROTOBUF:
            return encoded
        before, after = str(encoded(_SN)).split(str(_SN))
        return lambda sn: f"{before}{sn}{after}"

    async def _later(self, transport: ServerTransport, answer: str | bytes) -> None:
        await asyncio.sleep(self.delay)
        await transport.send(answer)

    async def push(self, rate: float, first: int, count: int) -> None:
        """Push PoseSpeed; prints when each was sent."""
        numbers = range(first, first + count)
        frames = {
            codec: [_push_frame(codec, number) for number in numbers]
            for codec in set(self._subscribers.values())
        }
        # as the bytes that go out: making them is none of what is measured
        lines = [
            (transport, [transport.header(len(f), text=codec is JSON) + f for f in frames[codec]])
            for transport, codec in self._subscribers.items()
        ]
        sent = []
        cpu = time.process_time()
        due = time.monotonic()
        for i in range(count):
            sent.append(time.monotonic())
            for transport, ready in lines:
                await transport.send_raw(ready[i])
            due = max(due + 1 / rate, time.monotonic() - _MADE_UP)
            await asyncio.sleep(max(0.0, due - time.monotonic() - _FINE))
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
