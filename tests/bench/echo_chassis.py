"""A chassis that answers at once with the same, and pushes PoseSpeed: the other end of a bench.

    python -m bench.echo_chassis [--delay S] [--transport websocket|tcp]

It prints its port. Each line on its standard input is a command: `push RATE COUNT` pushes so many
PoseSpeed at so many Hz to whoever subscribed and prints, as JSON, when each was sent
(time.monotonic, s) and the CPU time in s that it took itself. Their `mileage` counts from 1.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time

from woosh_robot_agent.link.frames import Codec
from woosh_robot_agent.link.json_codec import JsonCodec
from woosh_robot_agent.link.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.transports import (
    Transport,
    TransportClosedError,
    serve_tcp,
    serve_websocket,
)
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotInfo
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.protos import message_type

SUBSCRIPTION = "woosh.Subscription"
_JSON: Codec = JsonCodec(defaults=True)
_BINARY: Codec = ProtobufCodec()


class EchoChassis:
    """Answers every request with an empty message of its type, some s later if told so."""

    def __init__(self, delay: float) -> None:
        self._delay = delay
        self._subscribers: dict[Transport, Codec] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    async def serve(self, transport: Transport) -> None:
        try:
            while True:
                await self._take(transport, await transport.recv())
        except TransportClosedError:
            self._subscribers.pop(transport, None)

    async def _take(self, transport: Transport, frame: str | bytes) -> None:
        codec = _JSON if isinstance(frame, str) else _BINARY
        envelope = codec.decode(frame)
        if envelope.type == SUBSCRIPTION:
            if PoseSpeed.DESCRIPTOR.full_name in codec.body(envelope, Subscription).topics:
                self._subscribers[transport] = codec
            return
        cls = message_type(envelope.type)
        body = RobotInfo(robot_id=1) if cls is RobotInfo else cls()
        answer = codec.encode(envelope.type, body, sn=envelope.sn, ok=True, timestamp=1)
        if self._delay:
            task = asyncio.ensure_future(self._later(transport, answer))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        else:
            await transport.send(answer)

    async def _later(self, transport: Transport, answer: str | bytes) -> None:
        await asyncio.sleep(self._delay)
        await transport.send(answer)

    async def push(self, rate: float, count: int) -> None:
        """Push PoseSpeed; prints when each was sent."""
        sent = []
        message = PoseSpeed(robot_id=1)
        message.pose.x, message.twist.linear = 4.23276472, 0.5
        due = time.monotonic()
        cpu = time.process_time()
        for number in range(1, count + 1):
            message.mileage = number
            frames = {
                codec: codec.encode(PoseSpeed.DESCRIPTOR.full_name, message, timestamp=1)
                for codec in set(self._subscribers.values())
            }
            sent.append(time.monotonic())
            for transport, codec in self._subscribers.items():
                await transport.send(frames[codec])
            due += 1 / rate
            await asyncio.sleep(max(0.0, due - time.monotonic()))
        print(json.dumps({"sent": sent, "cpu": time.process_time() - cpu}), flush=True)


async def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--delay", type=float, default=0.0)
    parser.add_argument("--transport", default="websocket")
    options = parser.parse_args()
    chassis = EchoChassis(options.delay)
    serve = serve_tcp if options.transport == "tcp" else serve_websocket
    listener = await serve(chassis.serve, "127.0.0.1", 0, max_size=2**26)
    print(listener.port, flush=True)
    lines = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    while line := await lines.readline():
        _, rate, count = line.split()
        await chassis.push(float(rate), int(count))


if __name__ == "__main__":
    asyncio.run(main())
