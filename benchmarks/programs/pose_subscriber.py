"""A bare subscriber to PoseSpeed topics.

    python -m benchmarks.programs.pose_subscriber TOPIC...

The field `mileage` numbers the messages. Each line on stdin is a command:

    take LAST QUIET POLL    receive until message LAST has arrived on every topic, or nothing has
                            arrived for QUIET seconds; then print, as JSON, the numbers that
                            arrived on each topic and their times (time.monotonic, in seconds)

POLL is the polling period for new messages, in seconds. Polling costs very little CPU time. With
0 the program takes each message as soon as it arrives.
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
    """Records the arrival time of each message."""

    def __init__(self, topics: list[str]) -> None:
        node = Node("subscriber", start_parameter_services=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._arrivals: dict[str, list[tuple[int, float]]] = {topic: [] for topic in topics}
        self._last_arrival = 0.0
        self._subscriptions: dict[str, Any] = {
            topic: node.create_subscription(
                PoseSpeed,
                topic,
                partial(self._record, self._arrivals[topic]),
                QoSProfile(depth=5000),
            )
            for topic in topics
        }

    def take(self, last: int, quiet: float, poll: float) -> dict[str, list[tuple[int, float]]]:
        """Execute the command `take`; return number and time of each message, by topic."""
        for arrivals in self._arrivals.values():
            arrivals.clear()
        self._last_arrival = time.monotonic()
        while not self._complete(last) and time.monotonic() - self._last_arrival < quiet:
            if poll:
                time.sleep(poll)
                self._take_waiting()
            else:
                self._executor.spin_once(timeout_sec=0.1)
        return self._arrivals

    def _complete(self, last: int) -> bool:
        return all(arrivals and arrivals[-1][0] >= last for arrivals in self._arrivals.values())

    def _take_waiting(self) -> None:
        for topic, subscription in self._subscriptions.items():
            handle = subscription.handle
            with handle:
                while (taken := handle.take_message(PoseSpeed, False)) is not None:
                    self._record(self._arrivals[topic], taken[0])

    def _record(self, arrivals: list[tuple[int, float]], message: Any) -> None:
        self._last_arrival = time.monotonic()
        arrivals.append((message.mileage, self._last_arrival))


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
