"""The service `stop` acts at once, in any state, and before everything that waits to be sent."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from google.protobuf.message import Message
from std_srvs.srv import Trigger

from tests.harness import Logs, Robot, wait_future, wait_until
from tests.motion.moving import MOVING
from tests.motion.test_requests import COMMAND_MOTION
from tests.node.cmd_vel import Sender
from tests.node.goals import (
    ABORTED,
    CANCELED,
    EXECUTE,
    slow_down,
    step,
    step_goal,
    task,
)
from woosh_robot_agent.convert import converter
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.motion.requests import may_move
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.srv import Speak
from woosh_ros_msgs.action import StepControl

TWIST = "woosh.robot.Twist"
SPEAK = "woosh.robot.Speak"


def is_standing(simulator: SimulatorThread) -> bool:
    return not (simulator.state.velocity.speed or simulator.state.velocity.turn)


def test_stop_ends_a_velocity_and_every_goal(robot: Robot):
    robot.set_motion_timing(hold=0.0)
    slow_down(robot.chassis)  # so that no goal ends by itself
    assert robot.command("robot/Twist", angular=0.5).ok
    answer = robot.call(Trigger, "stop")
    assert (answer.success, answer.message) == (True, "stopped")
    last: Any = robot.chassis.last(TWIST)
    assert (last.linear, last.angular) == (0.0, 0.0)
    for kind, start in (
        ("StepControl", partial(step, robot, 20.0)),
        ("task", partial(task, robot)),
    ):
        wait_until(lambda: is_standing(robot.chassis))
        goal = start()
        wait_until(lambda: not is_standing(robot.chassis))
        answer = robot.call(Trigger, "stop")
        assert (answer.success, answer.message) == (True, f"stopped; {kind} cancelled")
        assert goal.result()[0] == ABORTED, "its own client did not cancel it"


def test_stop_without_a_link_says_what_to_do(robot: Robot):
    robot.chassis.stop_listening()
    robot.wait_lost()
    answer = robot.call(Trigger, "stop")
    assert not answer.success
    assert "NOT STOPPED: not connected" in answer.message
    assert "emergency stop" in answer.message


def test_a_cancel_and_a_stop_are_sent_even_when_too_many_requests_are_in_flight(
    simulator, connect, client
):
    connect(max_in_flight=1)
    slow_down(simulator)
    goal = step(client, 5.0)
    goal.feedback.wait_count(1)
    simulator.mute(SPEAK)
    client.call_async(Speak, "robot/Speak")
    simulator.wait_received(SPEAK)
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert client.call(Trigger, "stop").success


@pytest.mark.parametrize("turn", range(2))
def test_a_goal_requested_before_the_stop_does_not_move_the_robot(robot: Robot, turn: int):
    """The goal may arrive before or after the stop."""
    robot.set_motion_timing(hold=3600.0)  # however slow the machine is
    action = robot.action(StepControl, "ros/StepControl")
    robot.service(Trigger, "stop")
    sent = robot.in_executor(partial(action.send_goal_async, step_goal(20.0)))
    assert robot.call(Trigger, "stop").success
    handle = wait_future(sent)
    assert wait_future(robot.in_executor(handle.get_result_async)).status == ABORTED
    wait_until(lambda: is_standing(robot.chassis))


def test_after_a_stop_no_request_moves_the_robot(robot: Robot, logs: Logs):
    robot.set_motion_timing(hold=3600.0)
    velocities = Sender(robot)
    poses = robot.publisher(PoseStamped, "goal_pose")
    commands = [each for each in COMMANDS if each.request in COMMAND_MOTION]
    for endpoint in commands:
        robot.service(class_of(endpoint.srv, "srv"), endpoint.name)
    assert robot.call(Trigger, "stop").success

    for endpoint in commands:
        moving = next(each for each in MOVING if each.DESCRIPTOR.full_name == endpoint.request)
        srv = class_of(endpoint.srv, "srv")
        response = robot.call(srv, endpoint.name, arg=to_ros(srv.Request, moving))
        assert not response.ok, endpoint.name
        assert "not sent: cancelled by a stop of the robot" in response.msg
    for action in ACTIONS:
        command = message_type(action.arg)()
        if "action" in command.DESCRIPTOR.fields_by_name:
            command.action = EXECUTE
        action_class = class_of(action.action, "action")
        goal = action_class.Goal(arg=to_ros(action_class.Goal, command))
        robot.send_goal(action_class, action.name, goal).wait_aborted(
            "not sent: cancelled by a stop of the robot"
        )
    velocities.send(x=0.3)
    logs.wait_text("cmd_vel: not sent: cancelled")
    pose = PoseStamped()
    pose.header.frame_id = "map"
    poses.publish(pose)
    logs.wait_text("goal_pose is ignored: not sent")

    assert not [each.type for each in robot.chassis.received if may_move(each.message)]
    assert is_standing(robot.chassis)


def to_ros(parent: Any, message: Message) -> Any:
    """Return the ROS message for the field `arg` of a request or a goal."""
    arg = class_of(parent.get_fields_and_field_types()["arg"], "msg")
    return converter(arg, type(message)).to_ros(message)
