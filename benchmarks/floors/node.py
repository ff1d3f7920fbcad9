"""The node of a floor whose executor also looks at as many services as the agent has."""

from __future__ import annotations

from typing import Any

import rclpy

from woosh_robot_msgs.srv import PoseSpeed

_OTHER_SERVICES = 51


def floor_node(name: str = "floor", namespace: str = "/floor") -> Any:
    """Return a new node with services that nobody calls."""
    rclpy.init()
    node = rclpy.create_node(name, namespace=namespace)
    for number in range(_OTHER_SERVICES):
        node.create_service(PoseSpeed, f"other/S{number}", lambda _request, response: response)
    return node
