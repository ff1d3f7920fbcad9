"""Detection of a second agent in the same namespace.

Clients cannot tell the two apart: both respond to every call and publish on every topic, and both
execute every command, unless one of them only observes (`observe_only`).
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any

from rclpy.node import NodeNameNonExistentError

from woosh_robot_agent.endpoints import QUERIES, TOPICS
from woosh_robot_agent.ros.releases import count_services

UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""Name that rmw reports for the node of an endpoint before it has discovered the node."""
_LOG = logging.getLogger(__name__)
_PERIOD = 5.0
"""Period of the checks of the ROS graph, in seconds."""
_MAX_LEASE = 25.0
"""Time after which a process that was killed has certainly left the graph, in seconds.

The middleware notices it after 20 s.
"""


class SecondAgentDetector:
    """Detects other nodes that offer the same topics and services as this agent.

    Attributes:
        warning: description of the other agent, and what to do; empty if there is none.
    """

    def __init__(self, node: Any) -> None:
        self.warning = ""
        self._node = node
        self._topic = node.resolve_topic_name(TOPICS[0].name)
        """A topic that every agent publishes."""
        self._service = node.resolve_service_name(QUERIES[0].name)
        """A service that every agent offers."""
        self._seen_since = 0.0
        """Monotonic time at which another agent was first seen; 0 while there is none."""

    async def run(self) -> None:
        """Check the ROS graph periodically, until cancelled."""
        while True:
            self._check_graph()
            await asyncio.sleep(_PERIOD)

    def _check_graph(self) -> None:
        """Check the ROS graph now, and log a second agent that was not there at the last check."""
        before, self.warning = self.warning, ""
        # these counts are cheap; naming the nodes is not
        publishers = self._node.count_publishers(self._topic)
        if max(publishers, count_services(self._node, self._service)) < 2:
            self._seen_since = 0.0
            return
        self._seen_since = self._seen_since or time.monotonic()
        if others := sorted(self._others()):
            # a node that was killed stays in the graph for a while
            is_alive = time.monotonic() - self._seen_since > _MAX_LEASE
            runs = "runs" if is_alive else "runs, or has just ended,"
            self.warning = (
                f"another agent {runs} in the same namespace: node {', node '.join(others)}. Both "
                "respond to each call, and each executes every command unless its observe_only is "
                "true: end one of them, or start it in another namespace"
            )
            if not before:
                _LOG.warning("%s", self.warning)

    def _others(self) -> Iterator[str]:
        """Yield the names of the other nodes that publish the topic or offer the service."""
        own = self._node.get_fully_qualified_name()
        agents = Counter(
            _path(each.node_name, each.node_namespace)
            for each in self._node.get_publishers_info_by_topic(self._topic)
            if each.node_name != UNKNOWN_NODE  # the name will be known at the next check
        )
        for name, namespace in set(self._node.get_node_names_and_namespaces()):
            try:
                services = self._node.get_service_names_and_types_by_node(name, namespace)
            except NodeNameNonExistentError:  # it has just left the graph
                continue
            path = _path(name, namespace)
            if self._service in dict(services) and not agents[path]:
                agents[path] = 1
        agents[own] -= 1  # without this agent; another one may have the same name
        yield from (name for name, count in agents.items() if count > 0)


def _path(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"
