"""The task of the robot that drives a leg."""

from __future__ import annotations

import math
from itertools import pairwise

from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.pb.util.navigation_pb2 import PlanPath
from woosh_robot_agent.vda5050.model.order import Node, Trajectory
from woosh_robot_agent.vda5050.model.state import Position
from woosh_robot_agent.vda5050.orders.curve import curve_points
from woosh_robot_agent.vda5050.orders.legs import Leg


def leg_task(leg: Leg, position: Position | None) -> ExecTask:
    """Return the task that drives a leg, without its id.

    Args:
        leg: the leg.
        position: position of the robot; None if unknown.
    """
    request = ExecTask(type=task.kPick)
    if leg.goal.mark:
        request.mark_no = leg.goal.mark
    elif leg.edges[0].trajectory is not None:
        for edge, node in zip(leg.edges, leg.nodes, strict=True):
            if edge.trajectory is not None:
                _add_segment(request, _along(edge.trajectory, node), PlanPath.kStrict)
    else:
        poses = _through(leg.nodes, position)
        if len(poses) == 1:
            request.pose.CopyFrom(poses[0])
        else:
            _add_segment(request, poses, PlanPath.kOptimal)
    return request


def _add_segment(request: ExecTask, poses: list[Pose2D], optimal: PlanPath.Optimal) -> None:
    segment = request.plan_path.plan_path.add(target=poses[-1], optimal=optimal)
    segment.path.poses.extend(poses)


def _through(nodes: tuple[Node, ...], position: Position | None) -> list[Pose2D]:
    """Return a pose for each node. Without `theta`, its heading is that of the way to the node."""
    poses: list[Pose2D] = []
    here = None if position is None else (position.x, position.y)
    heading = 0.0 if position is None else position.theta
    for node in nodes:
        place = node.position
        if place is None:
            continue
        if here is not None and here != (place.x, place.y):
            heading = math.atan2(place.y - here[1], place.x - here[0])
        here = (place.x, place.y)
        heading = heading if place.theta is None else place.theta
        poses.append(Pose2D(x=place.x, y=place.y, theta=heading))
    return poses


def _along(trajectory: Trajectory, end: Node) -> list[Pose2D]:
    """Return the poses along a trajectory, without its start, where the robot stands."""
    points = curve_points(trajectory)
    poses = [
        Pose2D(x=there[0], y=there[1], theta=math.atan2(there[1] - here[1], there[0] - here[0]))
        for here, there in pairwise(points)
        if here != there
    ]
    if end.position is not None and end.position.theta is not None:
        poses[-1].theta = end.position.theta
    return poses
