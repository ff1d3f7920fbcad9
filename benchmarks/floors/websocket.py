"""Floor of the link: round trips over a bare WebSocket, with the library that the link uses.

    python -m benchmarks.floors.websocket URL

Each line on stdin has one or two numbers. The first one is a number of requests. Without a second
one, the program sends them one after the other, and prints one line of JSON: all round-trip times
and its own CPU time for all of them, in seconds. The second one is a number of requests in flight:
the program then prints the time that all requests took, in seconds.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from typing import Any

import websockets

REQUEST = '{"type":"woosh.robot.PoseSpeed","body":{},"sn":%d,"timestamp":1700000000000}'


async def _overlapping(socket: Any, count: int, in_flight: int) -> float:
    """Keep some requests in flight; return the time that all of them took, in seconds."""
    begun = time.perf_counter()
    for number in range(in_flight):
        await socket.send(REQUEST % (number + 1))
    for number in range(in_flight, count + in_flight):
        await socket.recv()
        if number < count:
            await socket.send(REQUEST % (number + 1))
    return time.perf_counter() - begun


async def main(url: str) -> None:
    number = 0
    async with websockets.connect(url, compression=None, max_size=None) as socket:
        for line in sys.stdin:
            count, *in_flight = map(int, line.split())
            if in_flight:
                print(json.dumps(await _overlapping(socket, count, *in_flight)), flush=True)
                continue
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
