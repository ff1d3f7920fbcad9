"""The jobs of a task at its target."""

from __future__ import annotations

from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.behaviour.charging import Charge
from woosh_robot_agent.simulator.behaviour.jobs import Job
from woosh_robot_agent.simulator.behaviour.lifting import MoveLift
from woosh_robot_agent.simulator.behaviour.navigation import PATH_MARGIN, Navigate
from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.behaviour.steps import Shift, Steps
from woosh_robot_agent.simulator.world.footprints import FOOTPRINTS, outer_radius
from woosh_robot_agent.simulator.world.maps import Mark

_DOCKING_DISTANCE = 0.5
"""Distance before a mark at which docking starts, in metres."""

_DOCKING_SPEED = 0.2
"""Speed of docking, in m/s."""


def jobs_at_mark(
    robot: Robot, mark: Mark, kind: util_task_pb2.Type, direction: util_task_pb2.Direction
) -> list[Job]:
    """Return the jobs of a task at a mark: drive there, dock if needed, do the work.

    A robot that carries something leaves the dock again. A robot that charges stays.
    """
    work = work_jobs(robot, kind, direction)
    start = mark.pose.moved(-_DOCKING_DISTANCE, 0.0, 0.0)
    clearance = outer_radius(FOOTPRINTS[robot.footprint]) + PATH_MARGIN
    if (
        not work
        or not robot.map.contains(*start.point)
        or robot.map.clearance(*start.point) < clearance
    ):
        return [Navigate(mark.pose), *work]
    enter = _docking(_DOCKING_DISTANCE, util_action_pb2.kSecondposEnter)
    leave = _docking(-_DOCKING_DISTANCE, util_action_pb2.kSecondposQuit)
    stays = kind == util_task_pb2.kCharge
    return [Navigate(start), enter, *work] if stays else [Navigate(start), enter, *work, leave]


def work_jobs(
    robot: Robot, kind: util_task_pb2.Type, direction: util_task_pb2.Direction
) -> list[Job]:
    """Return the jobs of a task after its arrival; none for a task that only drives."""
    if kind == util_task_pb2.kCharge:
        return [Charge()]
    if kind == util_task_pb2.kCarry:
        unload = direction == util_task_pb2.kCutting
        return [MoveLift(robot.jack, 0.0 if unload else robot.jack.travel)]
    return []


def _docking(distance: float, kind: util_action_pb2.Type) -> Steps:
    return Steps([Shift(0.0, distance, _DOCKING_SPEED)], avoid=True, kind=kind)
