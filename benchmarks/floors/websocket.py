"""Floor of the link: round trips over a bare WebSocket, with the library that the link uses.

    python -m benchmarks.floors.websocket URL

Each line on stdin is a number. The program sends that number of requests, one after the other, and
prints one line of JSON: all round-trip times and its own CPU time for all of them, in seconds.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time

import websockets

REQUEST = '{"type":"woosh.robot.PoseSpeed","body":{},"sn":%d,"timestamp":1700000000000}'


async def main(url: str) -> None:
    number = 0
    async with websockets.connect(url, compression=None, max_size=None) as socket:
        for line in sys.stdin:
            count = int(line)
            times = []
            for left in range(count + max(1, count // 10), 0, -1):
                if left == count:  # the requests before this one were a warm-up
                    cpu = time.process_time()
                    times.clear()
                number += 1
                begun = time.perf_counter()
                await socket.send(REQUEST % number)
                await socket.recv()
                times.append(time.perf_counter() - begun)
            print(json.dumps({"times": times, "cpu": time.process_time() - cpu}), flush=True)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
