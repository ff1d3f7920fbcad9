"""Every request in the agent's table is classified: does it move the robot, does it only read?"""

from __future__ import annotations

import pytest
from google.protobuf.message import Message

from tests.motion.moving import MOVING
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, OWN_READS, QUERIES
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.motion.gate import cancel_orders
from woosh_robot_agent.motion.requests import commands_motion, may_move, only_reads, takes_wheels
from woosh_robot_agent.pb.robot.robot_pack_pb2 import (
    ActionOrder,
    CountData,
    Follow,
    RobotWiFi,
    Twist,
)
from woosh_robot_agent.pb.ros.action_pb2 import LiftControl, MoveBase, StepControl, kCancel
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.task.woosh_task_pb2 import RepeatTask
from woosh_robot_agent.pb.util import action_pb2
from woosh_robot_agent.pb.util.common_pb2 import Pose2D

COMMAND_MOTION = {
    "woosh.robot.ActionOrder",
    "woosh.robot.ExecPreTask",
    "woosh.robot.ExecTask",
    "woosh.robot.ExecTaskSet",
    "woosh.robot.Follow",
    "woosh.robot.Twist",
    "woosh.task.RepeatTask",
}
MOVE_NOTHING = {
    "woosh.map.Delete",
    "woosh.map.Download",
    "woosh.map.Rename",
    "woosh.map.SceneData",
    "woosh.map.SceneMd5",
    "woosh.map.SceneSync",
    "woosh.map.Upload",
    "woosh.map.mark.storage.Create",
    "woosh.map.mark.storage.Delete",
    "woosh.map.mark.storage.Find",
    "woosh.map.mark.storage.Storages",
    "woosh.map.mark.storage.Update",
    "woosh.robot.BuildMap",
    "woosh.robot.ChangeNavMode",
    "woosh.robot.ChangeNavPath",
    "woosh.robot.CountData",
    "woosh.robot.Deployment",
    "woosh.robot.InitRobot",
    "woosh.robot.LED",
    "woosh.robot.PlanNavPath",
    "woosh.robot.RobotWiFi",
    "woosh.robot.ScannerData",
    "woosh.robot.SetMuteCall",
    "woosh.robot.SetOccupancy",
    "woosh.robot.SetProgramMute",
    "woosh.robot.SetRobotPose",
    "woosh.robot.Speak",
    "woosh.robot.SwitchControlMode",
    "woosh.robot.SwitchFootPrint",
    "woosh.robot.SwitchMap",
    "woosh.robot.SwitchWorkMode",
    "woosh.robot.setting.AutoCharge",
    "woosh.robot.setting.AutoPark",
    "woosh.robot.setting.GoodsCheck",
    "woosh.robot.setting.Identity",
    "woosh.robot.setting.Power",
    "woosh.robot.setting.Server",
    "woosh.robot.setting.Sound",
}
"""Commands that do not move a standing robot."""

READING_COMMANDS = {
    "woosh.map.Download",
    "woosh.map.SceneData",
    "woosh.map.SceneMd5",
    "woosh.map.SceneSync",
    "woosh.map.mark.storage.Find",
    "woosh.map.mark.storage.Storages",
    "woosh.robot.CountData",
    "woosh.robot.PlanNavPath",
    "woosh.robot.ScannerData",
}

RESTING: tuple[Message, ...] = (
    Twist(),
    Twist(linear=-0.0),
    ActionOrder(order=action_pb2.kCancel),
    ActionOrder(order=action_pb2.kPause),
    Follow(type=False),
    RepeatTask(order=RepeatTask.kPut),
    RepeatTask(order=RepeatTask.kDel),
    *cancel_orders().values(),
    CallAction(step_control=StepControl(steps=[StepControl.Step(value=1.0)], action=kCancel)),
    CallAction(move_base=MoveBase(poses=[Pose2D(x=1.0)], target_pose=Pose2D(x=1.0))),
    CallAction(lift_control=LiftControl(execute_mode=LiftControl.kUp)),
)


def test_each_command_of_the_table_is_classified() -> None:
    """Add a new command to one of the two sets, and if it moves, to motion/requests.py.

    If it only reads, set `reads` in the table, and add it to READING_COMMANDS.
    """
    commands = {command.request for command in COMMANDS}
    assert commands == COMMAND_MOTION | MOVE_NOTHING
    assert {name for name in commands if commands_motion(message_type(name)())} == COMMAND_MOTION
    assert {name for name in commands if only_reads(message_type(name)())} == READING_COMMANDS


def test_queries_and_the_agents_own_requests_read_and_command_no_motion() -> None:
    for name in (*(query.request for query in QUERIES), *OWN_READS):
        assert only_reads(message_type(name)()), name
        assert not commands_motion(message_type(name)()), name


def test_each_action_of_the_table_commands_motion() -> None:
    for action in ACTIONS:
        request = message_type("woosh.ros.CallAction" if action.member else action.arg)()
        assert commands_motion(request), action.name
        assert not only_reads(request), action.name


def test_moving_requests_are_recognised() -> None:
    for request in MOVING:
        assert commands_motion(request), request
        assert may_move(request), request
        assert not only_reads(request), request


def test_orders_to_rest_are_recognised() -> None:
    for request in RESTING:
        assert commands_motion(request), request
        assert not may_move(request), request
        assert not takes_wheels(request), request
        assert not only_reads(request), request


@pytest.mark.parametrize(
    ("request_", "reads"),
    [
        (RobotWiFi(order=RobotWiFi.kWiFiList), True),
        (RobotWiFi(order=RobotWiFi.kWiFiList, content=b"x"), False),
        (RobotWiFi(), False),
        *((RobotWiFi(order=order), False) for order in range(2, 7)),
        (CountData(req_type=CountData.kGet), True),
        (CountData(req_type=CountData.kSync), False),
    ],
)
def test_of_some_requests_only_one_order_reads(request_: Message, reads: bool) -> None:
    assert only_reads(request_) is reads
