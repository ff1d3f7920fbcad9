"""A client with SROS2, run as a process. It prints one word for each operation that it tries."""

from __future__ import annotations

import sys

import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile

from tests.harness import wait_until
from woosh_robot_agent.testing import spinning
from woosh_robot_msgs.msg import Mode as ModeMsg
from woosh_robot_msgs.srv import PoseSpeed


def main() -> None:
    rclpy.init(args=sys.argv)
    node = rclpy.create_node("client")
    modes: list[ModeMsg] = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(ModeMsg, "/woosh_robot/robot/Mode", modes.append, latched)
    poses = node.create_client(PoseSpeed, "/woosh_robot/robot/PoseSpeed")
    wait_until(poses.service_is_ready, "the service")
    with spinning(node):
        answer = poses.call_async(PoseSpeed.Request())
        wait_until(answer.done, "the answer")
        print("service")
        wait_until(lambda: modes, "the topic")
        print("topic")
        try:
            forbidden = node.create_client(SetParameters, "/woosh_robot/agent/set_parameters")
        except Exception as error:  # rcl's error if the middleware refuses
            print("refused", type(error).__name__)
        else:
            print("refused" if not forbidden.service_is_ready() else "ALLOWED")
    rclpy.shutdown()


main()
