"""Ownership of the wheels when a paused job resumes."""

from __future__ import annotations

from google.protobuf.message import Message

from tests.quick_chassis import quick_config
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask, Follow
from woosh_robot_agent.pb.ros import action_pb2
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import task_pb2
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.protocol.dispatch import dispatch


def ask(chassis: Chassis, request: Message) -> None:
    answer = dispatch(chassis, request)
    assert answer.ok, answer.msg
    for _ in range(10):
        chassis.tick(TIME_STEP)


def steps(action: action_pb2.ControlAction) -> CallAction:
    step = action_pb2.StepControl.Step(mode=action_pb2.StepControl.Step.kStraight, value=1.0)
    return CallAction(step_control=action_pb2.StepControl(action=action, steps=[step]))


def test_resumed_task_ends_following() -> None:
    chassis = Chassis(quick_config(seed=1))
    ask(chassis, ExecTask(mark_no="A2", type=task_pb2.kPick))
    ask(chassis, ActionOrder(order=util_action_pb2.kPause))
    ask(chassis, Follow(type=True))
    assert chassis.follower.active
    ask(chassis, ActionOrder(order=util_action_pb2.kContinue))
    assert (chassis.follower.active, chassis.ownership.driver[:4]) == (False, "task")


def test_resumed_action_ends_following() -> None:
    chassis = Chassis(quick_config(seed=1))
    ask(chassis, steps(action_pb2.kExecute))
    ask(chassis, steps(action_pb2.kPause))
    ask(chassis, Follow(type=True))
    assert chassis.follower.active
    ask(chassis, steps(action_pb2.kResume))
    assert (chassis.follower.active, chassis.ownership.driver) == (False, "StepControl")
