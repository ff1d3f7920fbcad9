"""A bare publisher of velocities.

    python -m benchmarks.programs.velocity_publisher TOPIC...

It waits for a subscriber to each topic, then prints `true`. Each line on stdin is a command:

    publish TOPIC RATE COUNT    publish COUNT velocities at RATE Hz, with linear.x counting from 1
                                in steps of 0.0001 m/s; then print, as JSON, the time of each one
                                (time.monotonic, in seconds)
"""

from __future__ import annotations

import json
import sys
import time

import rclpy
from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile

STEP = 0.0001
"""Difference of two successive velocities, in m/s."""


def main(topics: list[str]) -> None:
    rclpy.init()
    node = rclpy.create_node("velocity_publisher")
    publishers = {
        topic: node.create_publisher(Twist, topic, QoSProfile(depth=1)) for topic in topics
    }
    while not all(publisher.get_subscription_count() for publisher in publishers.values()):
        time.sleep(0.05)
    print("true", flush=True)
    for line in sys.stdin:
        _, topic, rate, count = line.split()
        message = Twist()
        sent = []
        due = time.monotonic()
        for number in range(1, int(count) + 1):
            message.linear.x = number * STEP
            sent.append(time.monotonic())
            publishers[topic].publish(message)
            due += 1 / float(rate)
            time.sleep(max(0.0, due - time.monotonic()))
        print(json.dumps(sent), flush=True)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except KeyboardInterrupt:
        pass
