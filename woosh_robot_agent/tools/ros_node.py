"""The ROS node of a tool."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.ros.executor import Executor
from woosh_robot_agent.ros.logs import init_arguments
from woosh_robot_agent.ros.second_agent import UNKNOWN_NODE


def find_agents(node: Node) -> set[tuple[str, str]]:
    """Return name and namespace of the agents in the namespace of a node.

    Every node that publishes the first topic of the table of endpoints counts as an agent.
    """
    topic = node.resolve_topic_name(TOPICS[0].name)
    return {
        (each.node_name, each.node_namespace)
        for each in node.get_publishers_info_by_topic(topic)
        if each.node_name != UNKNOWN_NODE
    }


_TIMEOUT = 0.1
"""Maximum delay before the thread notices `stop`, in seconds."""


class NodeThread:
    """A ROS node with a context of its own, whose callbacks run in a thread of its own.

    Args:
        namespace: namespace of the node, unless the arguments set another namespace.
        args: command-line arguments for rclpy.
        domain: ROS_DOMAIN_ID; by default from the environment.

    Raises:
        Exception: the namespace or the arguments are invalid; the type is rclpy's.
    """

    def __init__(
        self, name: str, namespace: str, args: Sequence[str] = (), domain: int | None = None
    ) -> None:
        context = Context()
        rclpy.init(args=init_arguments(args), context=context, domain_id=domain)
        try:
            # users may end the namespace with a slash, which rclpy refuses
            self.node = Node(name, namespace=namespace.rstrip("/"), context=context)
        except BaseException:
            rclpy.try_shutdown(context=context)
            raise
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, on_error: Callable[[Exception], None]) -> None:
        """Start the thread. An exception of a callback ends it, and is passed to `on_error`."""
        self._thread = threading.Thread(
            target=self._spin, args=(on_error,), name="ros", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """End the thread: no callback runs any more. Call it from another thread."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def close(self) -> None:
        """End the thread, and destroy the node."""
        self.stop()
        context = self.node.context
        self.node.destroy_node()
        rclpy.try_shutdown(context=context)

    def _spin(self, on_error: Callable[[Exception], None]) -> None:
        executor = Executor(context=self.node.context)
        executor.add_node(self.node)
        try:
            while not self._stop.is_set():
                executor.spin_once(timeout_sec=_TIMEOUT)
        except ExternalShutdownException:
            pass
        except Exception as error:
            on_error(error)
        finally:
            executor.shutdown()
