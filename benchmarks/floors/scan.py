"""Floor of scan: requests a scan over a WebSocket, and publishes a message for each answer.

    python -m benchmarks.floors.scan URL

It does not read the answers: it publishes one prepared message of 1080 beams, at about 10 Hz.
"""

from __future__ import annotations

import asyncio
import sys
from array import array

import rclpy
import websockets
from rclpy.qos import QoSProfile
from sensor_msgs.msg import LaserScan

_PERIOD = 0.099
"""Time between two scans, in seconds.

The agent's is 0.1 s. With the same period, one of the two would publish right after the other in
the whole measurement, with the caches that the other has just filled.
"""
_REQUEST = '{"type":"woosh.robot.ScannerData","body":{},"sn":%d,"timestamp":1700000000000}'


async def main(url: str) -> None:
    rclpy.init()
    node = rclpy.create_node("floor", namespace="/floor")
    publisher = node.create_publisher(LaserScan, "scan", QoSProfile(depth=10))
    message = LaserScan(angle_min=-2.2, angle_max=2.2, range_max=25.0)
    message.header.frame_id = "laser"
    message.ranges = array("f", (1.0 + beam / 137.0 for beam in range(1080)))
    loop = asyncio.get_running_loop()
    due = loop.time()
    number = 0
    async with websockets.connect(url, compression=None, max_size=None) as socket:
        print("connected to", url, file=sys.stderr, flush=True)
        while True:
            number += 1
            await socket.send(_REQUEST % number)
            await socket.recv()
            message.header.stamp = node.get_clock().now().to_msg()
            publisher.publish(message)
            due += _PERIOD
            await asyncio.sleep(due - loop.time())


if __name__ == "__main__":
    try:
        asyncio.run(main(sys.argv[1]))
    except KeyboardInterrupt:
        pass
