"""Floor of `record` without a proxy: a client of a bare WebSocket that discards what it receives.

    python -m benchmarks.floors.client URL

It subscribes to the types that `programs/chassis.py` pushes, and prints `true` when that has taken
effect.
"""

from __future__ import annotations

import asyncio
import json
import sys

import websockets

_SUBSCRIPTION = {"sub": True, "topics": ["woosh.robot.PoseSpeed"]}


async def main(url: str) -> None:
    async with websockets.connect(url, compression=None, max_size=None) as socket:
        for sn, (name, body) in enumerate(
            [("woosh.Subscription", _SUBSCRIPTION), ("woosh.robot.RobotInfo", {})]
        ):
            await socket.send(json.dumps({"type": name, "body": body, "sn": sn}))
        await socket.recv()  # the answer to the second one, and so follows the subscription
        print("true", flush=True)
        while True:
            await socket.recv()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
