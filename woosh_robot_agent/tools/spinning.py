"""Spinning of the ROS node of a tool."""

from __future__ import annotations

import threading

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

_TIMEOUT = 0.1
"""Maximum delay before the end is noticed, in seconds."""


def spin_until(stop: threading.Event, node: Node) -> None:
    """Execute the callbacks of a node until `stop` is set or its context is shut down.

    Raises:
        Exception: a callback raised it.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    try:
        while not stop.is_set():
            executor.spin_once(timeout_sec=_TIMEOUT)
    except ExternalShutdownException:
        pass
    finally:
        executor.shutdown()
