"""Floor of service calls: a node with 52 services, like the agent, that answer at once."""

from __future__ import annotations

from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from woosh_robot_msgs.srv import PoseSpeed


def answer(_request: Any, response: Any) -> Any:
    response.info.mileage = 1204
    return response


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("floor", namespace="/woosh_robot")
    for number in range(51):
        node.create_service(PoseSpeed, f"other/S{number}", answer)
    node.create_service(PoseSpeed, "robot/PoseSpeed", answer)
    rclpy.spin(node, SingleThreadedExecutor())


if __name__ == "__main__":
    try:
        main()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
