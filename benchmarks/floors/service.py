"""Floor of service calls: a node with 52 services, like the agent, that answer at once."""

from __future__ import annotations

from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from benchmarks.floors.node import floor_node
from woosh_robot_msgs.srv import PoseSpeed


def answer(_request: Any, response: Any) -> Any:
    response.info.mileage = 1204
    return response


def main() -> None:
    node = floor_node(namespace="/woosh_robot")
    node.create_service(PoseSpeed, "robot/PoseSpeed", answer)
    rclpy.spin(node, SingleThreadedExecutor())


if __name__ == "__main__":
    try:
        main()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
