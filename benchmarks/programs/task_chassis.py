"""A chassis that executes each task at once: it reports it as running, and then as completed.

    python -m benchmarks.programs.task_chassis [--transport websocket|tcp]

It answers like `echo_chassis`, and prints its port. After each line on stdin it prints, as JSON,
by its id, the time at which each task since the last such line came, and the time of its last
report (time.monotonic, in seconds).
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time

from benchmarks.programs.echo_chassis import EchoChassis
from woosh_robot_agent.link.codecs import server_codec
from woosh_robot_agent.link.codecs.frames import Codec
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.server import ServerTransport, serve_tcp, serve_websocket
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.pb.util.task_pb2 import kCompleted, kExecuting

_FIRST_REPORT = 0.02
"""Delay of the first report after the answer, in seconds."""
_DURATION = 0.15
"""Time from the first report on a task to the last one, in seconds."""


class TaskChassis(EchoChassis):
    """Answers every request, and reports on each task.

    Attributes:
        times: Time of arrival and time of the last report of each task, by its id.
    """

    def __init__(self) -> None:
        super().__init__(beams=0, map_size=0)
        self.times: dict[int, tuple[float, float]] = {}

    async def _handle(self, transport: ServerTransport, frame: str | bytes) -> None:
        arrival = time.monotonic()
        codec = server_codec(frame)
        envelope = codec.decode(frame)
        await super()._handle(transport, frame)
        if envelope.type == full_name(ExecTask):
            task_id = codec.body(envelope, ExecTask).task_id
            task = asyncio.ensure_future(self._report(transport, codec, task_id, arrival))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _report(
        self, transport: ServerTransport, codec: Codec, task_id: int, arrival: float
    ) -> None:
        first, last = (
            codec.encode(full_name(TaskProc), TaskProc(robot_task_id=task_id, state=s), timestamp=1)
            for s in (kExecuting, kCompleted)
        )
        await asyncio.sleep(_FIRST_REPORT)
        await transport.send(first)
        await asyncio.sleep(_DURATION)
        self.times[task_id] = (arrival, time.monotonic())
        await transport.send(last)


async def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--transport", default="websocket")
    serve = serve_tcp if parser.parse_args().transport == "tcp" else serve_websocket
    chassis = TaskChassis()
    listener = await serve(chassis.serve, "127.0.0.1", 0, max_size=2**26)
    print(listener.port, flush=True)
    lines = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    while await lines.readline():
        print(json.dumps(chassis.times), flush=True)
        chassis.times = {}


if __name__ == "__main__":
    asyncio.run(main())
