"""The state of a vehicle from reports that make no sense."""

from __future__ import annotations

import math

import pytest

from woosh_robot_agent.pb.robot.robot_pb2 import (
    NavPath,
    OperationState,
    PoseSpeed,
    RobotInfo,
    TaskProc,
)
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.pb.util.common_pb2 import Pose2D, Twist
from woosh_robot_agent.vda5050.robot.status import path, robot_status


def task_proc(state: task.State.ValueType, action_state: action.State.ValueType) -> RobotInfo:
    """What a robot with a task reports."""
    report = TaskProc(robot_task_id=1, state=state)
    report.action.state = action_state
    return RobotInfo(task_proc=report)


@pytest.mark.parametrize(
    ("report", "blocked"),
    [
        (RobotInfo(operation_state=OperationState(nav=OperationState.kImpede)), True),
        (RobotInfo(operation_state=OperationState(nav=OperationState.kNarrow)), False),
        (task_proc(task.kPaused, action.kRosWarning), True),  # as a TR-200 reports it
        (task_proc(task.kExecuting, action.kRosExecuting), False),
        (task_proc(task.kPaused, action.kSuspend), False),
        (task_proc(task.kCanceled, action.kRosWarning), False),
        (RobotInfo(), False),
    ],
)
def test_the_robot_tells_that_an_obstacle_blocks_its_way(report: RobotInfo, blocked: bool) -> None:
    assert robot_status(report).blocked == blocked


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_numbers_that_are_not_finite_are_left_out(bad: float) -> None:
    good = PoseSpeed(map_id=3, pose=Pose2D(x=1.0, y=2.0, theta=3.0), twist=Twist(linear=0.5))
    status = robot_status(RobotInfo(pose_speed=good))
    assert status.position is not None
    assert status.velocity is not None
    lost = PoseSpeed(map_id=3, pose=Pose2D(x=1.0, theta=bad), twist=Twist(angular=bad))
    status = robot_status(RobotInfo(pose_speed=lost))
    assert status.position is None
    assert status.velocity is None
    report = NavPath()
    report.path.poses.extend([Pose2D(x=1.0, y=2.0), Pose2D(x=bad)])
    assert path(report) == ((1.0, 2.0),)
