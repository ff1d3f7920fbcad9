"""Floor: a bare service, one of 52 on a node, as the agent has them."""

from __future__ import annotations

import sys
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException

from woosh_robot_agent.agent import make_executor
from woosh_robot_msgs.srv import PoseSpeed


def answer(_request: Any, response: Any) -> Any:
    response.info.mileage = 1204
    return response


def main(executor_name: str) -> None:
    rclpy.init()
    node = rclpy.create_node("floor", namespace="/woosh_robot")
    for number in range(51):
        node.create_service(PoseSpeed, f"other/S{number}", answer)
    node.create_service(PoseSpeed, "robot/PoseSpeed", answer)
    executor = make_executor(executor_name)
    executor.add_node(node)
    try:
        while rclpy.ok():
            executor.spin_once(timeout_sec=1.0)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main(sys.argv[1])
