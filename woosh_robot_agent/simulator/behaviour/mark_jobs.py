"""The jobs of a task at its target."""

from __future__ import annotations

from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.behaviour.charging import Charge, back_out
from woosh_robot_agent.simulator.behaviour.jobs import Job, Wait
from woosh_robot_agent.simulator.behaviour.lifting import MoveLift
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.behaviour.route import PATH_MARGIN
from woosh_robot_agent.simulator.behaviour.steps import Shift, Steps
from woosh_robot_agent.simulator.world.footprints import outer_radius
from woosh_robot_agent.simulator.world.maps import Mark


def jobs_at_mark(
    robot: Robot, mark: Mark, kind: util_task_pb2.Type, direction: util_task_pb2.Direction
) -> list[Job]:
    """Return the jobs of a task at a mark: drive there, dock if needed, do the work.

    A robot that carries something leaves the dock again. A robot that charges stays.
    """
    profile = robot.profile.charging
    work = work_jobs(robot, kind, direction)
    charge = kind == util_task_pb2.kCharge
    steps = profile.steps if charge else ()
    distance = profile.docking_distance
    start = mark.pose.moved(-distance - sum(steps), 0.0, 0.0)
    clearance = outer_radius(robot.outline) + PATH_MARGIN
    docks = (
        kind in (util_task_pb2.kCharge, util_task_pb2.kCarry)
        and robot.map.contains(*start.point)
        and robot.map.clearance(*start.point) >= clearance
    )
    if not docks:
        return [*leave_dock(robot), Navigate(mark.pose), *work]
    speed = profile.docking_speed
    way_in = [_move(distance, speed, util_action_pb2.kSecondposEnter)]
    way_in += [_move(step, profile.step_speed, util_action_pb2.kStepCtrl) for step in steps]
    way_out = [] if charge else [_move(-distance, speed, util_action_pb2.kSecondposQuit)]
    return [*leave_dock(robot), Navigate(start), *way_in, *work, *way_out]


def leave_dock(robot: Robot) -> list[Job]:
    """Return the jobs of a task before it drives: none, unless the robot stands in a dock."""
    leaves = robot.profile.tasks.leave_dock and robot.at_charger()
    return [back_out(robot)] if leaves else []


def work_jobs(
    robot: Robot, kind: util_task_pb2.Type, direction: util_task_pb2.Direction
) -> list[Job]:
    """Return the jobs of a task after its arrival; none for a task that only drives."""
    if kind == util_task_pb2.kCharge:
        return [Charge()]
    if kind == util_task_pb2.kCarry:
        unload = direction == util_task_pb2.kCutting
        return [MoveLift(robot.jack, 0.0 if unload else robot.jack.travel)]
    if kind != util_task_pb2.kParking and robot.profile.tasks.final_wait:
        return [Wait(0.0)]
    return []


def _move(distance: float, speed: float, kind: util_action_pb2.Type) -> Steps:
    return Steps([Shift(0.0, distance, speed)], avoid=True, kind=kind)
