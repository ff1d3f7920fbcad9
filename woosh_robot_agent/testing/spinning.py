"""Spinning nodes in the background of a test."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from woosh_robot_agent.testing.waiting import TIMEOUT

_SPIN_TIMEOUT = 1.0
"""Maximum duration of a call of `spin_once` without work, in seconds."""


class Spinner:
    """Spins an executor in a thread until it is stopped.

    An exception of a callback ends the spinning; `stop` raises it again.

    Args:
        executor: The executor; its nodes are added by the caller.
    """

    def __init__(self, executor: Any) -> None:
        self.executor = executor
        self._stop = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._spin, name="spinner", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop spinning and wait for the thread; raise the exception of a callback, if any."""
        self._stop.set()
        self.executor.create_task(lambda: None)  # ends `spin_once`; `wake` would not
        self._thread.join(TIMEOUT)
        if self._error is not None:
            raise self._error

    def _spin(self) -> None:
        try:
            while not self._stop.is_set():
                self.executor.spin_once(timeout_sec=_SPIN_TIMEOUT)
        except ExternalShutdownException:
            pass
        except BaseException as error:
            self._error = error


@contextlib.contextmanager
def spinning(*nodes: Any) -> Iterator[None]:
    """Spin nodes in a thread; at the end, raise the exception of a callback, if any.

    Args:
        nodes: Nodes of one context.
    """
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
