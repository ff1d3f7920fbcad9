"""A bare subscriber to PoseSpeed topics, as a program: `python -m benchmarks.subscriber TOPIC...`

`mileage` tells messages apart. Each line on its standard input, `take LAST QUIET POLL`, has it
receive until LAST has come on every topic, or nothing has for QUIET s; it then prints, as JSON, per
topic the numbers that came and when (time.monotonic, s). With POLL it looks for the newest ones
every so many s only, which costs next to nothing; with 0 it takes each message at once.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from functools import partial
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

from woosh_robot_msgs.msg import PoseSpeed


class Subscriber:
    """Notes when each message came."""

    def __init__(self, topics: list[str]) -> None:
        node = Node("subscriber", start_parameter_services=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._came: dict[str, list[tuple[int, float]]] = {topic: [] for topic in topics}
        self._heard = 0.0
        self._subscriptions: dict[str, Any] = {
            topic: node.create_subscription(
                PoseSpeed, topic, partial(self._note, self._came[topic]), QoSProfile(depth=5000)
            )
            for topic in topics
        }

    def take(self, last: int, quiet: float, poll: float) -> dict[str, list[tuple[int, float]]]:
        for came in self._came.values():
            came.clear()
        self._heard = time.monotonic()
        while not self._has(last) and time.monotonic() - self._heard < quiet:
            if poll:
                time.sleep(poll)
                self._look()
            else:
                self._executor.spin_once(timeout_sec=0.1)
        return self._came

    def _has(self, last: int) -> bool:
        return all(came and came[-1][0] >= last for came in self._came.values())

    def _look(self) -> None:
        for topic, subscription in self._subscriptions.items():
            handle = subscription.handle
            with handle:
                while (taken := handle.take_message(PoseSpeed, False)) is not None:
                    self._note(self._came[topic], taken[0])

    def _note(self, came: list[tuple[int, float]], message: Any) -> None:
        self._heard = time.monotonic()
        came.append((message.mileage, self._heard))


def main(topics: list[str]) -> None:
    rclpy.init()
    subscriber = Subscriber(topics)
    gc.collect()
    gc.disable()
    for line in sys.stdin:
        _, last, quiet, poll = line.split()
        print(json.dumps(subscriber.take(int(last), float(quiet), float(poll))), flush=True)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except KeyboardInterrupt:
        pass
