"""Floor of memory and start-up time: a node with the agent's entities, which do nothing.

    python -m benchmarks.floors.entities KIND:TYPE:NAME:DEPTH...

KIND is `service`, `action`, `publisher`, `latched` (a latched publisher) or `subscription`. DEPTH
is the queue depth of a topic.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

import rclpy
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile

MODULES = {"service": "srv", "action": "action"}
"""Module of the ROS types of each kind; that of kinds not listed is `msg`."""


def do_nothing(*_arguments: Any) -> None:
    pass


def create(node: Any, kind: str, type_name: str, name: str, depth: str) -> None:
    """Create one entity."""
    package, short = type_name.split("/")
    module = importlib.import_module(f"{package}.{MODULES.get(kind, 'msg')}")
    ros_type = getattr(module, short)
    qos = QoSProfile(depth=int(depth))
    if kind == "service":
        node.create_service(ros_type, name, do_nothing)
    elif kind == "action":
        ActionServer(node, ros_type, name, do_nothing)
    elif kind == "subscription":
        node.create_subscription(ros_type, name, do_nothing, qos)
    else:
        if kind == "latched":
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        node.create_publisher(ros_type, name, qos)


def main(entities: list[str]) -> None:
    rclpy.init()
    node = rclpy.create_node("agent", namespace="/woosh_robot")
    for entity in entities:
        create(node, *entity.split(":"))
    rclpy.spin(node)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
