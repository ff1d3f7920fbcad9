"""Nodes that run beside a test."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from woosh_robot_agent.testing.waiting import TIMEOUT


class Spinner:
    """Spins an executor in a thread until it is stopped.

    What a callback raises ends the spinning, and is raised again by `stop`.
    """

    def __init__(self, executor: Any) -> None:
        self.executor = executor
        self._stop = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._spin, name="spinner", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop, and return when the thread has ended."""
        self._stop.set()
        self._thread.join(TIMEOUT)
        if self._error is not None:
            raise self._error

    def _spin(self) -> None:
        try:
            while not self._stop.is_set():
                self.executor.spin_once(timeout_sec=0.05)
        except ExternalShutdownException:
            pass
        except BaseException as error:
            self._error = error


@contextlib.contextmanager
def spinning(*nodes: Any) -> Iterator[None]:
    """Have nodes of one context run in a thread meanwhile; raises what their callbacks raised."""
    executor = SingleThreadedExecutor(context=nodes[0].context)
    for node in nodes:
        executor.add_node(node)
    spinner = Spinner(executor)
    try:
        yield
    finally:
        try:
            spinner.stop()
        finally:
            executor.shutdown()
