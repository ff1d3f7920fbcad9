"""Floor: bare WebSocket round trips, with the library that the link uses.

Prints one line of JSON: the round trips in s, and the CPU time of this process in s.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time

import websockets

REQUEST = '{"type":"woosh.robot.PoseSpeed","body":{},"sn":%d,"timestamp":1700000000000}'


async def main(url: str, count: int) -> None:
    times = []
    async with websockets.connect(url, compression=None, max_size=None) as socket:
        for number in range(1, count + 100):
            if number == 100:  # warm
                cpu = time.process_time()
                times.clear()
            begun = time.perf_counter()
            await socket.send(REQUEST % number)
            await socket.recv()
            times.append(time.perf_counter() - begun)
    print(json.dumps({"times": times, "cpu": time.process_time() - cpu}))


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
