"""What a task does at its target, as a row of jobs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.behaviour.jobs import Charge, Job
from woosh_robot_agent.simulator.behaviour.navigation import MARGIN_M, Navigate
from woosh_robot_agent.simulator.behaviour.steps import Shift, Steps
from woosh_robot_agent.simulator.body.lift import MoveLift
from woosh_robot_agent.simulator.world.footprints import FOOTPRINTS, outer_radius
from woosh_robot_agent.simulator.world.maps import Mark

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.chassis import Chassis

#: How far before a mark a robot that has to dock there stops to take aim, and how fast it goes in.
_DOCKING_M = 0.5
_DOCKING_MPS = 0.2


def jobs_at_mark(
    chassis: Chassis, mark: Mark, kind: util_task_pb2.Type, direction: util_task_pb2.Direction
) -> list[Job]:
    """The jobs of a task at a mark: drive there, dock where the work needs it, work.

    A robot that carried something leaves the dock again; one that charges stays.
    """
    work = work_of(chassis, kind, direction)
    start = mark.pose.moved(-_DOCKING_M, 0.0, 0.0)
    room = outer_radius(FOOTPRINTS[chassis.footprint]) + MARGIN_M
    if (
        not work
        or not chassis.map.contains(*start.point)
        or chassis.map.clearance(*start.point) < room
    ):
        return [Navigate(mark.pose), *work]
    enter = _docking(_DOCKING_M, util_action_pb2.kSecondposEnter)
    leave = _docking(-_DOCKING_M, util_action_pb2.kSecondposQuit)
    stays = kind == util_task_pb2.kCharge
    return [Navigate(start), enter, *work] if stays else [Navigate(start), enter, *work, leave]


def work_of(
    chassis: Chassis, kind: util_task_pb2.Type, direction: util_task_pb2.Direction
) -> list[Job]:
    """What a task of a kind does where it arrives; nothing for one that only goes there."""
    if kind == util_task_pb2.kCharge:
        return [Charge()]
    if kind == util_task_pb2.kCarry:
        unload = direction == util_task_pb2.kCutting
        return [MoveLift(chassis.jack, 0.0 if unload else chassis.jack.travel)]
    return []


def _docking(distance: float, kind: util_action_pb2.Type) -> Steps:
    return Steps([Shift(0.0, distance, _DOCKING_MPS)], avoid=True, kind=kind)
