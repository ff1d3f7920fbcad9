"""Floor of goals: an action server that writes a frame to a socket for each goal.

    python -m benchmarks.floors.goal URL

Each report of the chassis is published as feedback, and the last one ends the goal. The program
does not read the reports: a prepared message takes the place of each.
"""

from __future__ import annotations

import sys
from typing import Any

import rclpy
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from benchmarks.floors.bare_socket import BareSocket
from benchmarks.floors.node import floor_node
from woosh_robot_msgs.action import ExecTask

FRAME = '{"type":"woosh.robot.ExecTask","body":{"taskId":"%d"},"sn":1,"timestamp":1700000000000}'
_REPORT = b"woosh.robot.TaskProc"
_LAST = b'"state":7'


def main(url: str) -> None:
    node = floor_node()
    goals: list[Any] = []
    feedback, result = ExecTask.Feedback(), ExecTask.Result()

    def send_goal(goal: Any) -> None:
        goals.append(goal)
        chassis.send(FRAME % goal.request.arg.task_id)

    def take_frame(frame: bytes) -> None:
        if _REPORT in frame:
            goals[0].publish_feedback(feedback)
            if _LAST in frame:
                goals.pop(0).execute()

    def execute(goal: Any) -> Any:
        goal.succeed()
        return result

    chassis = BareSocket(url, take_frame)
    server = ActionServer(
        node, ExecTask, "robot/ExecTask", execute, handle_accepted_callback=send_goal
    )
    print("connected to", url, file=sys.stderr, flush=True)
    rclpy.spin(node, SingleThreadedExecutor())
    server.destroy()


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
