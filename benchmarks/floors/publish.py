"""Floor of pushes: a thread that reads a WebSocket and publishes a message for each frame.

It reads only one field of a frame: `mileage`, the number of the push.
"""

from __future__ import annotations

import asyncio
import json
import re
import sys

import rclpy
import websockets
from rclpy.qos import DurabilityPolicy, QoSProfile

from woosh_robot_msgs.msg import PoseSpeed

QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_MILEAGE = re.compile(r'"mileage":(\d+)')


async def main(url: str) -> None:
    rclpy.init()
    node = rclpy.create_node("agent", namespace="/woosh_robot")
    publisher = node.create_publisher(PoseSpeed, "robot/PoseSpeed", QOS)
    message = PoseSpeed()
    topics = {"topics": ["woosh.robot.PoseSpeed"], "sub": True}
    async with websockets.connect(url, compression=None, max_size=None) as socket:
        await socket.send(json.dumps({"type": "woosh.Subscription", "body": topics}))
        print("connected to", url, file=sys.stderr, flush=True)
        async for frame in socket:
            found = _MILEAGE.search(frame)
            if found:
                message.mileage = int(found[1])
                publisher.publish(message)


if __name__ == "__main__":
    try:
        asyncio.run(main(sys.argv[1]))
    except KeyboardInterrupt:
        pass
