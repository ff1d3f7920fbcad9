"""Simulated chassis in one process, which report a change of their battery at given intervals.

    python -m benchmarks.programs.simulated_robots --count N --first ROBOT_ID [--speed S]

It prints the WebSocket ports. Then it takes commands on stdin: `start SECONDS` begins with the
changes, one in so many seconds from each robot, and `stop` ends them and prints when each was
pushed: robot id, percent, and time (time.monotonic).
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import json
import random
import sys
import time

from woosh_robot_agent.pb.robot.robot_pb2 import Battery
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.server import SimulatedChassis

CHARGES = range(30, 100)
"""Charges that are reported in turn, in percent."""
Push = tuple[int, int, float]
"""Id of the robot, charge, and time of the push."""


async def _change(robot: SimulatedChassis, period: float, pushes: list[Push]) -> None:
    """Report another charge again and again, until cancelled."""
    await asyncio.sleep(random.uniform(0.0, period))  # robots do not report all at once
    number = robot.config.robot_id
    for charge in itertools.cycle(CHARGES):
        pushes.append((number, charge, time.monotonic()))
        robot.push(Battery(charge_state=Battery.kNot, power=charge))
        await asyncio.sleep(period)


async def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--first", type=int, required=True)
    parser.add_argument("--speed", type=float, default=1.0)
    given = parser.parse_args()
    configs = [
        SimulatorConfig(port=0, tcp_port=0, speed=given.speed, robot_id=given.first + number)
        for number in range(given.count)
    ]
    loop = asyncio.get_running_loop()
    async with contextlib.AsyncExitStack() as stack:
        robots = [await stack.enter_async_context(SimulatedChassis(each)) for each in configs]
        print(json.dumps([robot.port for robot in robots]), flush=True)
        pushes: list[Push] = []
        changes: list[asyncio.Task[None]] = []
        while line := await loop.run_in_executor(None, sys.stdin.readline):
            command, *arguments = line.split()
            if command == "start":
                period = float(arguments[0])
                changes = [loop.create_task(_change(each, period, pushes)) for each in robots]
            elif command == "stop":
                for change in changes:
                    change.cancel()
                print(json.dumps(pushes), flush=True)
                pushes.clear()


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(main())
