"""A client with SROS2, run as a process. It writes one line for each operation that it tries.

The lines go to a file, because the middleware writes its errors between lines of the output.

    python3 -m tests.node.secured_client client|display FILE --ros-args --enclave ENCLAVE

The client does what its policy allows; the display also tries what `--read-only` excludes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import OccupancyGrid
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import LaserScan

from tests.harness import wait_until
from woosh_map_msgs.srv import Download
from woosh_robot_agent.testing import spinning
from woosh_robot_msgs.action import ExecTask
from woosh_robot_msgs.msg import Mode as ModeMsg
from woosh_robot_msgs.srv import ExecTask as ExecTaskSrv
from woosh_robot_msgs.srv import PoseSpeed, SwitchControlMode

AGENT = "/woosh_robot"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def say(*words: object) -> None:
    with open(sys.argv[2], "a") as file:
        print(*words, file=file)


def call(node: Node, srv: Any, name: str) -> Any:
    """Call a service; return its response."""
    client = node.create_client(srv, f"{AGENT}/{name}")
    wait_until(client.service_is_ready, name)
    answer = client.call_async(srv.Request())
    wait_until(answer.done, f"an answer of {name}")
    return answer.result()


def echo(node: Node, msg: Any, name: str, qos: QoSProfile) -> Any:
    """Return the first message on a topic."""
    found: list[Any] = []
    node.create_subscription(msg, f"{AGENT}/{name}", found.append, qos)
    wait_until(lambda: found, name)
    return found[0]


def read(node: Node) -> None:
    call(node, PoseSpeed, "robot/PoseSpeed")
    say("service")
    echo(node, ModeMsg, "robot/Mode", LATCHED)
    say("topic")
    say("scan", len(echo(node, LaserScan, "scan", QoSProfile(depth=5)).ranges) > 100)
    say("map", len(echo(node, OccupancyGrid, "map", LATCHED).data) > 10_000)
    response = call(node, Download, "map/Download")
    say("download", response.ok, sum(len(file.data) for file in response.ret.file_datas))


def run_task(node: Node) -> None:
    """Run a task from its goal to its result, with feedback."""
    action = ActionClient(node, ExecTask, f"{AGENT}/robot/ExecTask")
    wait_until(action.server_is_ready, "the action")
    goal = ExecTask.Goal()
    goal.arg.type.value = 1
    goal.arg.mark_no = "A2"
    states: list[int] = []
    sent = action.send_goal_async(
        goal, feedback_callback=lambda message: states.append(message.feedback.fb.state.value)
    )
    wait_until(sent.done, "the goal")
    result = sent.result().get_result_async()
    wait_until(result.done, "the result")
    say("task", result.result().status, bool(states))


def try_to(what: str, create: Callable[[], Any], is_usable: Callable[[Any], bool]) -> None:
    """Say whether something that the policy does not allow is refused."""
    try:
        created = create()
    except Exception as error:  # rcl's error if the middleware refuses
        say(what, "refused", type(error).__name__)
    else:
        try:
            wait_until(lambda: is_usable(created), timeout=5.0)  # discovery takes time
        except AssertionError:
            say(what, "refused")
        else:
            say(what, "ALLOWED")


def main() -> None:
    rclpy.init(args=sys.argv)
    role = sys.argv[1]
    node = rclpy.create_node(role)
    with spinning(node):
        read(node)
        if role == "client":
            run_task(node)
        else:
            for srv, name in (
                (SwitchControlMode, "robot/SwitchControlMode"),
                (ExecTaskSrv, "robot/ExecTask"),
            ):
                try_to(
                    name,
                    lambda srv=srv, name=name: node.create_client(srv, f"{AGENT}/{name}"),
                    lambda client: bool(client.service_is_ready()),
                )
            try_to(
                "task",
                lambda: ActionClient(node, ExecTask, f"{AGENT}/robot/ExecTask"),
                lambda client: bool(client.server_is_ready()),
            )
            try_to(
                "cmd_vel",
                lambda: node.create_publisher(Twist, f"{AGENT}/cmd_vel", 1),
                lambda publisher: publisher.get_subscription_count() > 0,
            )
        try_to(
            "set_parameters",
            lambda: node.create_client(SetParameters, f"{AGENT}/agent/set_parameters"),
            lambda client: bool(client.service_is_ready()),
        )
    rclpy.shutdown()


if __name__ == "__main__":
    main()
