"""The agent stood still while velocities came: none of them drives the robot afterwards."""

from __future__ import annotations

import signal
import time

from geometry_msgs.msg import PoseStamped

from tests.harness import Client, Program, wait_future, wait_until
from tests.node.cmd_vel import Sender
from tests.node.goals import ABORTED, step_goal
from woosh_robot_agent.motion.requests import may_move
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import Twist as TwistMsg
from woosh_robot_msgs.srv import Speak, Twist
from woosh_ros_msgs.action import StepControl

TWIST = "woosh.robot.Twist"
PAUSE = 2.5
"""Time for which the agent stands still, in seconds."""


def velocities(simulator: SimulatorThread) -> list[float]:
    """Return the speeds ahead that the chassis has received."""
    return [each.message.linear for each in simulator.received if each.type == TWIST]


def test_what_comes_during_the_pause_moves_nothing_and_the_reason_is_told(
    program: Program, simulator: SimulatorThread, client: Client
) -> None:
    service = client.service(Twist, "robot/Twist")
    action = client.action(StepControl, "ros/StepControl")
    poses = client.publisher(PoseStamped, "goal_pose")
    pose = PoseStamped()
    pose.header.frame_id = "map"
    pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w = 5.0, -6.8, 1.0
    sender = Sender(client)
    sender.repeat(50.0, x=0.2)
    wait_until(lambda: len(velocities(simulator)) > 3, "the first velocities")
    program.process.send_signal(signal.SIGSTOP)
    poses.publish(pose)
    request = Twist.Request(arg=TwistMsg(linear=0.2))
    calls = [service.call_async(request) for _ in range(20)]
    goal = client.in_executor(lambda: action.send_goal_async(step_goal(0.5)))
    time.sleep(PAUSE)
    sender.pause()  # as if the sender had died meanwhile
    before = len(velocities(simulator))
    program.process.send_signal(signal.SIGCONT)
    answers = [wait_future(call) for call in calls]
    assert not any(answer.ok for answer in answers)
    assert all("old" in each.msg or "stood still" in each.msg for each in answers), answers
    result = wait_future(client.in_executor(wait_future(goal).get_result_async))
    assert result.status == ABORTED
    assert "stood still" in result.result.ret.msg
    program.wait_says("goal_pose is ignored: not sent: the agent stood still")
    program.wait_says("old")
    assert client.call(Speak, "robot/Speak").ok  # the agent has handled what came before
    assert not any(velocities(simulator)[before:])
    moving = [each for each in simulator.received if may_move(each.message)]
    assert {each.type for each in moving} == {TWIST}, "those before the pause"
