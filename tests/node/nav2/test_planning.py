"""compute_path_to_pose and compute_path_through_poses."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest

from tests.harness import Logs, Robot
from tests.node.goals import START, answer_with_json
from tests.node.nav2.goals import (
    ABORTED,
    CANCELED,
    SUCCEEDED,
    Nav2Client,
    ahead,
    error_code,
    pose,
    poses_field,
)

nav2_actions = pytest.importorskip("nav2_msgs.action")
PLAN = "woosh.robot.PlanNavPath"


def points(path: Any) -> list[tuple[float, float]]:
    return [(each.pose.position.x, each.pose.position.y) for each in path.poses]


def length(path: Any) -> float:
    return sum(math.dist(here, there) for here, there in pairwise(points(path)))


def test_a_path_from_the_robot_to_a_pose(robot: Robot) -> None:
    status, result = Nav2Client(robot, "compute_path_to_pose", goal=ahead(3.0)).result()
    assert (status, error_code(result)) == (SUCCEEDED, 0)
    assert points(result.path)[0] == pytest.approx(START[:2], abs=0.01)
    assert length(result.path) == pytest.approx(3.0, abs=0.1)
    assert result.path.header.frame_id == "map"
    assert result.path.poses[-1].header.frame_id == "map"
    assert result.planning_time.nanosec
    assert robot.chassis.counts["woosh.ros.CallAction"] == 0


def test_a_path_from_another_pose(robot: Robot, logs: Logs) -> None:
    robot.chassis.answer_as(PLAN, PLAN)  # an answer of the type of the request
    goal = Nav2Client(
        robot,
        "compute_path_to_pose",
        goal=ahead(3.0),
        start=ahead(1.0),
        use_start=True,
        planner_id="GridBased",
    )
    assert length(goal.result()[1].path) == pytest.approx(2.0, abs=0.1)
    logs.wait_text("planner_id has no effect")


def through_poses(robot: Robot, poses: list[Any]) -> Nav2Client:
    field = poses_field(nav2_actions.ComputePathThroughPoses, "goals", poses)
    return Nav2Client(robot, "compute_path_through_poses", goals=field)


def test_a_path_through_poses(robot: Robot) -> None:
    status, result = through_poses(robot, [ahead(3.0), ahead(1.0)]).result()
    assert status == SUCCEEDED
    assert length(result.path) == pytest.approx(5.0, abs=0.2)
    assert len(set(points(result.path))) == len(points(result.path))


def test_without_a_path_the_reason_is_told(robot: Robot) -> None:
    for goal in (
        Nav2Client(robot, "compute_path_to_pose", goal=pose(1000.0, 1000.0)),
        through_poses(robot, [ahead(1.0), pose(1000.0, 1000.0)]),
    ):
        goal.wait_aborted(
            "to (1000.00, 1000.00): choose a goal on free floor", code="NO_VALID_PATH"
        )
    through_poses(robot, []).wait_aborted(code="NO_VIAPOINTS_GIVEN")
    robot.chassis.lose_localisation()
    robot.chassis.inject("refuse", type=PLAN, count=1)
    goal = Nav2Client(robot, "compute_path_to_pose", goal=ahead(3.0))
    goal.wait_aborted(
        "the robot has lost its localisation: call robot/SetRobotPose", code="UNKNOWN"
    )
    answer_with_json(robot.chassis, PLAN, body={"path": 5})
    goal = Nav2Client(robot, "compute_path_to_pose", goal=ahead(3.0))
    goal.wait_aborted("sent no usable path")


def test_a_new_goal_replaces_the_running_one_and_a_cancel_ends_it(robot: Robot) -> None:
    robot.chassis.mute(PLAN)
    first = Nav2Client(robot, "compute_path_to_pose", goal=ahead(3.0))
    second = Nav2Client(robot, "compute_path_to_pose", goal=ahead(3.0))
    assert first.result()[0] == ABORTED
    second.cancel()
    assert second.result()[0] == CANCELED
