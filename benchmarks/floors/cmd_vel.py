"""Floor of velocities: a subscriber to cmd_vel that writes a frame to a socket for each message.

    python -m benchmarks.floors.cmd_vel URL

It does not look at the answers of the chassis.
"""

from __future__ import annotations

import sys
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile

from benchmarks.floors.bare_socket import BareSocket
from benchmarks.floors.node import floor_node

FRAME = '{"type":"woosh.robot.Twist","body":{"linear":%r},"sn":1,"timestamp":1700000000000}'


def main(url: str) -> None:
    node = floor_node()
    chassis = BareSocket(url, lambda _frame: None)

    def drive(message: Any) -> None:
        chassis.send(FRAME % message.linear.x)

    node.create_subscription(Twist, "cmd_vel", drive, QoSProfile(depth=1))
    print("connected to", url, file=sys.stderr, flush=True)
    rclpy.spin(node, SingleThreadedExecutor())


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
