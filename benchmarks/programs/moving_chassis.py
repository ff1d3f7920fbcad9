"""A chassis whose robot moves all the time: each scan is another one, and poses come at 10 Hz.

    python -m benchmarks.programs.moving_chassis [--beams N]

It answers like `echo_chassis`, and prints its port.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools

from benchmarks.programs.echo_chassis import EchoChassis, Send, pose_speed, scan
from woosh_robot_agent.link.codecs.frames import Codec
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.server import serve_websocket
from woosh_robot_agent.link.transport import TransportClosedError
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, ScannerData

_VARIANTS = 20
"""Number of different scans."""
_PERIOD = 0.1
"""Time between two poses, in seconds."""


class MovingChassis(EchoChassis):
    """Answers with a different scan each time, and pushes poses."""

    def __init__(self, beams: int) -> None:
        super().__init__(beams, map_size=0)
        self._beams = beams

    def _make_answer(self, codec: Codec, type_name: str) -> Send:
        if type_name != full_name(ScannerData):
            return super()._make_answer(codec, type_name)
        answers = []
        for number in range(_VARIANTS):
            body = scan(self._beams)
            body.ranges[:] = [each + 0.01 * number for each in body.ranges]
            answers.append(self.answer_with(codec, type_name, body))
        turn = itertools.cycle(answers)
        return lambda transport, sn: next(turn)(transport, sn)

    async def push_poses(self) -> None:
        """Push poses until cancelled."""
        for number in itertools.count():
            message = pose_speed(number)
            message.pose.x += 0.01 * (number % 100)
            for transport, codec in list(self._subscribers.items()):
                try:
                    await transport.send(codec.encode(full_name(PoseSpeed), message, timestamp=1))
                except TransportClosedError:
                    continue
            await asyncio.sleep(_PERIOD)


async def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--beams", type=int, default=1080)
    chassis = MovingChassis(parser.parse_args().beams)
    listener = await serve_websocket(chassis.serve, "127.0.0.1", 0, max_size=2**26)
    print(listener.port, flush=True)
    await chassis.push_poses()


if __name__ == "__main__":
    asyncio.run(main())
