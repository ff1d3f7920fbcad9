"""Nodes that are driven to by marks, and the tasks of the robot that drive legs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import pytest

from tests.vda5050.orders import MAP, action, at, given, path, place
from woosh_robot_agent.pb.util.navigation_pb2 import PlanPath
from woosh_robot_agent.vda5050.messages.order import (
    Action,
    BlockingType,
    ControlPoint,
    NodePosition,
    Order,
    Trajectory,
)
from woosh_robot_agent.vda5050.orders.structure import with_marks
from woosh_robot_agent.vda5050.robot.tasks import leg_task

MARK = NodePosition(1.0, 0.0, MAP, theta=1.5)


def find(number: str, map_id: str) -> NodePosition | None:
    return MARK if (number, map_id) == ("b", MAP) else None


def with_b(position: NodePosition | None, actions: Sequence[Action] = ()) -> Order:
    """An order to node `b`, with the marks filled in."""
    order = path("abc", actions={"b": actions})
    nodes = (order.nodes[0], replace(order.nodes[1], position=position), order.nodes[2])
    return with_marks(replace(order, nodes=nodes), MAP, find)


def test_a_node_without_position_is_at_the_mark_of_its_name() -> None:
    node = with_b(None).nodes[1]
    assert (node.mark, node.position) == ("b", replace(MARK, theta=None))


@pytest.mark.parametrize(
    ("position", "mark"),
    [
        (place(1.0), "b"),
        (place(1.2, theta=1.55), "b"),
        (place(1.5), ""),
        (place(1.5, deviation_xy=0.6), "b"),
        (place(1.0, theta=0.0), ""),
        (place(1.0, map_id="roof"), ""),
    ],
)
def test_where_the_vehicle_works_it_drives_to_the_mark_at_the_same_place(
    position: NodePosition, mark: str
) -> None:
    assert with_b(position, [action("pick")]).nodes[1].mark == mark


@pytest.mark.parametrize("actions", [[], [action("speak", BlockingType.NONE)]])
def test_where_the_vehicle_does_not_work_it_drives_to_the_position(actions: list[Action]) -> None:
    assert with_b(place(1.0), actions).nodes[1].mark == ""


def test_a_leg_of_one_node_is_driven_to_its_pose() -> None:
    robot = given(path("ab", b=place(1.0, y=1.0, theta=0.5)))
    task = leg_task(robot.drives[0].leg, at(0.0))
    assert (task.pose.x, task.pose.y, task.pose.theta) == (1.0, 1.0, 0.5)
    assert not task.HasField("plan_path")


def test_without_a_heading_the_robot_arrives_straight_on() -> None:
    robot = given(path("ab", b=place(1.0, y=1.0)))
    task = leg_task(robot.drives[0].leg, at(0.0))
    assert task.pose.theta == pytest.approx(math.pi / 4)


def test_a_leg_of_several_nodes_is_a_path_through_them() -> None:
    robot = given(path("abc", c=place(1.0, y=1.0, theta=0.0)))
    (stretch,) = leg_task(robot.drives[0].leg, at(0.0)).plan_path.plan_path
    assert stretch.optimal == PlanPath.kOptimal
    assert [(pose.x, pose.y, pose.theta) for pose in stretch.path.poses] == [
        (1.0, 0.0, 0.0),
        (1.0, 1.0, 0.0),
    ]
    assert stretch.target == stretch.path.poses[-1]


def test_trajectories_are_strict_paths_with_the_heading_along_them() -> None:
    corner = Trajectory(
        1,
        (0.0, 0.0, 0.5, 1.0, 1.0),
        (ControlPoint(0.0, 0.0), ControlPoint(0.0, 1.0), ControlPoint(1.0, 1.0)),
    )
    robot = given(path("ab", b=place(1.0, y=1.0, theta=-1.0), edges={"ab": {"trajectory": corner}}))
    (stretch,) = leg_task(robot.drives[0].leg, at(0.0)).plan_path.plan_path
    assert stretch.optimal == PlanPath.kStrict
    poses = [(pose.x, pose.y, round(pose.theta, 6)) for pose in stretch.path.poses]
    assert poses == [(0.0, 1.0, round(math.pi / 2, 6)), (1.0, 1.0, -1.0)]
