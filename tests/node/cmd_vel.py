"""A publisher of cmd_vel."""

from __future__ import annotations

import threading
import time
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped

from tests.harness import Client


class Sender:
    """Publishes on cmd_vel, once or at a rate."""

    def __init__(self, client: Client, message_class: Any = Twist) -> None:
        self._client = client
        self._publisher = client.publisher(message_class, "cmd_vel")
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def send(self, x: float = 0.0, y: float = 0.0, turn: float = 0.0) -> None:
        message = Twist()
        message.linear.x, message.linear.y, message.angular.z = x, y, turn
        self._publisher.publish(message)

    def send_stamped(self, x: float, age: float) -> None:
        message = TwistStamped()
        message.twist.linear.x = x
        at = self._client.node.get_clock().now().nanoseconds - int(age * 1e9)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(at, 10**9)
        self._publisher.publish(message)

    def repeat(self, rate: float, **velocity: float) -> None:
        def loop() -> None:
            while not self._stop.wait(1 / rate):
                self.send(**velocity)

        self._thread = threading.Thread(target=loop, daemon=True)
        self._thread.start()

    def pause(self) -> float:
        """Stop repeating; return the time of the end."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        self._stop.clear()
        return time.monotonic()
