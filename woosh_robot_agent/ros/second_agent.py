"""Detection of a second agent in the same namespace.

Clients cannot tell the two apart: both respond to every call and publish on every topic, and both
execute every command, unless one of them only observes (`observe_only`).

The process of an endpoint is read from its global identifier (GID). The first 8 bytes of a GID of
Fast DDS, the default middleware of ROS 2, are: 2 bytes for the vendor, 2 for the computer (from its
network addresses), the lower 2 of the process id, and 2 random ones of the process. This form is
not documented, and other middleware uses another one. So a GID is interpreted only if that of this
process has this form.
"""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from typing import Any

from rclpy.node import NodeNameNonExistentError

from woosh_robot_agent.endpoints import QUERIES, TOPICS
from woosh_robot_agent.ros.releases import count_services

UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""Name that rmw reports for the node of an endpoint before it has discovered the node."""
_FAST_DDS = b"\x01\x0f"
"""First two bytes of a GID of Fast DDS: the vendor."""
_PID_MASK = 0xFFFF
"""Mask of the bits of a process id that a GID contains."""
_PROCESSES = Path("/proc")
"""Folder that has a subfolder for each process, named by its id."""


class Place(Enum):
    """Place of a process, seen from this one."""

    THIS_PROCESS = "in this process"
    THIS_COMPUTER = "on this computer"
    ENDED = "in a process on this computer that has ended"
    OTHER_COMPUTER = "on another computer, or in a container"
    UNKNOWN = ""


def process_of(gid: Sequence[int]) -> bytes:
    """Return the part of a GID that identifies the process."""
    return bytes(gid[:8])


def is_possibly_own(gid: Sequence[int]) -> bool:
    """Return True if a GID has the form of Fast DDS, and the process id of this process."""
    data = bytes(gid)
    return data[:2] == _FAST_DDS and _pid(data) == os.getpid() & _PID_MASK


def place_of(gid: Sequence[int], own: Sequence[int]) -> tuple[Place, int]:
    """Return where a process runs, and its process id; 0 if that is not known.

    Args:
        gid: GID of an endpoint of the process.
        own: GID of an endpoint of this process.
    """
    data = bytes(gid)
    if not is_possibly_own(own) or data[:2] != _FAST_DDS:
        return Place.UNKNOWN, 0
    if process_of(gid) == process_of(own):
        return Place.THIS_PROCESS, os.getpid()
    if data[2:4] != bytes(own)[2:4]:
        return Place.OTHER_COMPUTER, 0
    running = [pid for pid in _process_ids() if pid & _PID_MASK == _pid(data)]
    if not running:
        return Place.ENDED, 0
    return Place.THIS_COMPUTER, running[0] if len(running) == 1 else 0


def _pid(gid: bytes) -> int:
    return int.from_bytes(gid[4:6], "little")


def _process_ids() -> list[int]:
    return [int(entry.name) for entry in _PROCESSES.iterdir() if entry.name.isdigit()]


_LOG = logging.getLogger(__name__)

PERIOD = 2.0
"""Period of the checks of the ROS graph, in seconds."""
LEASE = 25.0
"""Time after which a process that was killed has certainly left the graph, in seconds.

The middleware notices it after 20 s.
"""


class SecondAgent:
    """Looks for other nodes that offer the same topics and services as this agent.

    Args:
        node: the agent's node.

    Attributes:
        warning: description of the other agent, and what to do; empty if there is none.
    """

    def __init__(self, node: Any) -> None:
        self.warning = ""
        self._node = node
        self._topic = node.resolve_topic_name(TOPICS[0].name)
        self._service = node.resolve_service_name(QUERIES[0].name)
        self._seen = 0.0
        """Monotonic time at which another agent was first seen; 0 while there is none."""

    async def run(self) -> None:
        """Check the ROS graph periodically, until cancelled."""
        while True:
            self.look()
            await asyncio.sleep(PERIOD)

    def look(self) -> None:
        """Check the ROS graph now, and log a second agent that was not there at the last check."""
        before, self.warning = self.warning, ""
        # these counts are cheap; naming the nodes is not
        publishers = self._node.count_publishers(self._topic)
        if max(publishers, count_services(self._node, self._service)) < 2:
            self._seen = 0.0
            return
        self._seen = self._seen or time.monotonic()
        self.warning = self._describe(certain=time.monotonic() - self._seen > LEASE)
        if self.warning and not before:
            _LOG.warning("%s", self.warning)

    def _describe(self, *, certain: bool) -> str:
        """Return the warning; empty if the other agent has just ended.

        Args:
            certain: True if a process that was killed would have left the graph by now.
        """
        publishers, alive = self._other_publishers(certain=certain)
        others = publishers + self._other_servers()
        if not others:
            return ""
        runs = "runs" if certain or alive else "runs, or has just ended,"
        return (
            f"another agent {runs} in the same namespace: {'; '.join(others)}. Both respond to "
            "each call, and each executes every command unless its observe_only is true: end one "
            "of them, or start it in another namespace"
        )

    def _other_publishers(self, *, certain: bool) -> tuple[list[str], bool]:
        """Return the other nodes that publish a topic of the agent.

        Returns:
            Name and place of each node, and True if one of them certainly runs.
        """
        found = list(self._node.get_publishers_info_by_topic(self._topic))
        own = self._own(found)
        if own is not None:
            found.remove(own)
        texts, alive = [], False
        for each in found:
            if each.node_name == UNKNOWN_NODE:
                continue  # its name will be known the next time
            place, pid = Place.UNKNOWN, 0
            if own is not None:
                place, pid = place_of(each.endpoint_gid, own.endpoint_gid)
            if place is Place.ENDED:
                if not certain:
                    continue  # the rest of an agent that was killed
                place = Place.THIS_COMPUTER  # in a container with its own process ids
            name = f"node {each.node_namespace.rstrip('/')}/{each.node_name}"
            where = f"{place.value}, process {pid}" if pid else place.value
            texts.append(f"{name} {where}".rstrip())
            alive = alive or pid > 0
        return texts, alive

    def _own(self, found: list[Any]) -> Any:
        """Return this agent's publisher; None if it cannot be told from the others."""
        possible = [each for each in found if is_possibly_own(each.endpoint_gid)]
        if len({process_of(each.endpoint_gid) for each in possible}) == 1:
            return possible[0]
        name = self._node.get_name(), self._node.get_namespace()
        named = [each for each in found if (each.node_name, each.node_namespace) == name]
        return named[0] if len(named) == 1 else None

    def _other_servers(self) -> list[str]:
        """Return the names of other nodes that offer a service of the agent but no topic."""
        publishers = {
            (each.node_name, each.node_namespace)
            for each in self._node.get_publishers_info_by_topic(self._topic)
        }
        own = self._node.get_name(), self._node.get_namespace()
        return [
            f"node {namespace.rstrip('/')}/{name}"
            for name, namespace in self._node.get_node_names_and_namespaces()
            if (name, namespace) not in {own, *publishers} and self._serves(name, namespace)
        ]

    def _serves(self, name: str, namespace: str) -> bool:
        """Return True if a node offers the service."""
        try:
            services = self._node.get_service_names_and_types_by_node(name, namespace)
        except NodeNameNonExistentError:  # it has just left the graph
            return False
        return self._service in dict(services)
