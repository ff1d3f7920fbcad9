"""Floor: a node with as many services, topics and actions as the agent, and nothing behind them."""

from __future__ import annotations

import sys
from typing import Any

import rclpy
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException

from woosh_robot_agent.agent import make_executor
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, QUERIES, TOPICS
from woosh_robot_agent.services import ros_type
from woosh_robot_agent.standard.table import STANDARD, Kind
from woosh_robot_agent.topics import latched


def nothing(*_arguments: Any) -> Any:
    return None


def main(executor_name: str) -> None:
    rclpy.init()
    node = rclpy.create_node("agent", namespace="/woosh_robot")
    for service in (*QUERIES, *COMMANDS):
        node.create_service(ros_type(service.srv, "srv"), service.name, nothing)
    for topic in TOPICS:
        node.create_publisher(ros_type(topic.msg, "msg"), topic.name, latched(topic.depth))
    for action in ACTIONS:
        ActionServer(node, ros_type(action.action, "action"), action.name, nothing)
    for entry in STANDARD:
        if entry.switch == "publish_tf":  # off by default
            continue
        if entry.kind is Kind.SERVICE:
            node.create_service(ros_type(entry.type, "srv"), entry.name, nothing)
        elif entry.kind is Kind.INPUT:
            node.create_subscription(ros_type(entry.type, "msg"), entry.name, nothing, 1)
        else:
            node.create_publisher(ros_type(entry.type, "msg"), entry.name, entry.depth)
    executor = make_executor(executor_name)
    executor.add_node(node)
    try:
        while rclpy.ok():
            executor.spin_once(timeout_sec=1.0)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main(sys.argv[1])
