"""The state of a vehicle from reports that make no sense."""

from __future__ import annotations

import math

import pytest

from woosh_robot_agent.pb.robot.robot_pb2 import NavPath, PoseSpeed, RobotInfo
from woosh_robot_agent.pb.util.common_pb2 import Pose2D, Twist
from woosh_robot_agent.vda5050.robot.status import path, robot_status


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
