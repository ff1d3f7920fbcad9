"""Floor of memory, start and end: nodes with the agent's entities, which do nothing.

    python -m benchmarks.floors.entities NODES KIND:TYPE:NAME:DEPTH...

NODES is their number; each node has all of the entities. KIND is `service`, `action`, `publisher`,
`latched` (a latched publisher) or `subscription`. DEPTH is the queue depth of a topic.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

import rclpy
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile

MODULES = {"service": "srv", "action": "action"}
"""Module of the ROS types of each kind; that of kinds not listed is `msg`."""


def do_nothing(*_arguments: Any) -> None:
    pass


def create(node: Any, kind: str, type_name: str, name: str, depth: str) -> Any:
    """Create one entity. Return an action server, which its node does not destroy."""
    package, short = type_name.split("/")
    module = importlib.import_module(f"{package}.{MODULES.get(kind, 'msg')}")
    ros_type = getattr(module, short)
    qos = QoSProfile(depth=int(depth))
    if kind == "service":
        node.create_service(ros_type, name, do_nothing)
    elif kind == "action":
        return ActionServer(node, ros_type, name, do_nothing)
    elif kind == "subscription":
        node.create_subscription(ros_type, name, do_nothing, qos)
    else:
        if kind == "latched":
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        node.create_publisher(ros_type, name, qos)
    return None


def main(count: int, entities: list[str]) -> None:
    rclpy.init()
    namespaces = ["/woosh_robot", *(f"/woosh_robot_{number}" for number in range(1, count))]
    nodes = [rclpy.create_node("agent", namespace=namespace) for namespace in namespaces]
    servers = [create(node, *entity.split(":")) for node in nodes for entity in entities]
    executor = SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    print("ready", file=sys.stderr, flush=True)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    for server in filter(None, servers):
        server.destroy()
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
