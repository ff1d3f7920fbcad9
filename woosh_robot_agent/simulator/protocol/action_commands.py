"""Handlers of remote control, following, actions and the planning of paths."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.ros import action_pb2, ros_pack_pb2
from woosh_robot_agent.pb.util import navigation_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.jobs import (
    STEP_SPEED,
    Charge,
    Done,
    Job,
    MoveLift,
    Shift,
    Steps,
    Turn,
    leave_charger_job,
)
from woosh_robot_agent.simulator.behaviour.navigation import Navigate, NoRouteError, plan_route
from woosh_robot_agent.simulator.body.base import STANDSTILL, Velocity
from woosh_robot_agent.simulator.body.devices import Device
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import (
    Result,
    command,
    pose,
    poses,
    query,
    usable_speed,
)
from woosh_robot_agent.simulator.protocol.reports import pose2d
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.world.geometry import Pose


@command(pack.Twist)
def _twist(chassis: Chassis, request: pack.Twist) -> Result:
    """Drive by remote control. A velocity of zero stops everything that drives, in any mode."""
    velocity = Velocity(request.linear, request.linear_y, request.angular)
    if velocity == STANDSTILL:
        driver, is_automatic = chassis.ownership.driver, chassis.tasks.automatic
        chassis.ownership.stop_wheels("stopped by a velocity of zero")
        if not driver:
            return None
        outcome = "cancelled" if is_automatic else "paused, continue or cancel it"
        return f"stopped: {driver} is {outcome}"
    readiness = chassis.readiness
    if readiness.key_manual and not readiness.key_accepts:
        raise RefusedError(refusals.KEY_AT_MANUAL)
    if readiness.emergency_stop:
        raise RefusedError(refusals.TWIST_IN_EMERGENCY_STOP)
    if readiness.battery_empty:
        raise RefusedError(refusals.TWIST_WITH_EMPTY_BATTERY)
    if readiness.control == util_robot_pb2.kMaintain:
        raise RefusedError(refusals.TWIST_IN_MAINTENANCE_MODE)
    if velocity.left and not chassis.omnidirectional:
        raise RefusedError("a differential base cannot move sideways: linear_y must be 0")
    chassis.ownership.drive(velocity)
    return None


@command(pack.Follow)
def _follow(chassis: Chassis, request: pack.Follow) -> None:
    if request.type:  # a flag: follow or stop following
        chassis.readiness.require_ready()
        chassis.ownership.follow()
    else:
        chassis.follower.active = False


_MAX_STEPS = 1000
"""Maximum number of steps of an action."""

_MIN_LIFT_SPEED = 0.001
"""Minimum speed of the lift, in m/s."""

_StepMode = action_pb2.StepControl.Step
_Lift3 = action_pb2.LiftControl3


@command(ros_pack_pb2.CallAction)
def _call_action(chassis: Chassis, request: ros_pack_pb2.CallAction) -> None:
    """Execute, cancel, pause or resume an action, or set the navigation mode."""
    field = request.WhichOneof("action")
    if field is None:
        raise RefusedError("CallAction names no action: set one of its fields")
    action: Any = getattr(request, field)
    name = action.DESCRIPTOR.full_name
    if field == "nav_mode":
        _set_navigation_mode(chassis, action)
        # This action needs no device, so `ownership` has nothing to decide.
        chassis.actions.start(name, Done("navigation mode set"))
        return
    if field not in _JOBS:
        raise RefusedError(f"unknown action {action.type}: this chassis has {', '.join(_JOBS)}")
    if action.action == action_pb2.kExecute:
        chassis.readiness.require_ready()
        # Leaving the charger needs the wheels, and ends a charge too.
        ends = Device.CHARGER if field == "charge_control" else Device.NONE
        chassis.ownership.start_action(name, _JOBS[field](chassis, action), ends=ends)
        if field == "charge_control" and action.execute_mode == action_pb2.ChargeControl.kExit:
            chassis.battery.charging = robot_pb2.Battery.kNot  # even if the robot need not drive
    elif action.action == action_pb2.kCancel:
        chassis.actions.cancel(name)
    elif action.action == action_pb2.kPause:
        chassis.actions.pause(name)
    elif action.action == action_pb2.kResume:
        chassis.readiness.require_ready()
        chassis.ownership.resume_action(name)
    else:
        raise RefusedError(
            f"unknown control action {action.action}: 0 is cancel, 1 execute, 2 pause, 3 resume"
        )


_LONGEST_WAIT = 2**32 - 1
"""Largest value of `ModeSetting.wait_timeout`, in seconds."""


def _set_navigation_mode(chassis: Chassis, action: action_pb2.NavigationMode) -> None:
    """Set the mode of the running or paused navigation; raise RefusedError if there is none."""
    modes = {
        action_pb2.NavigationMode.kVagueAvoid: (navigation_pb2.kVague, navigation_pb2.kAvoid),
        action_pb2.NavigationMode.kAccurateAvoid: (navigation_pb2.kAccurate, navigation_pb2.kAvoid),
        action_pb2.NavigationMode.kWaitNav: (navigation_pb2.kAccurate, navigation_pb2.kNavWait),
        action_pb2.NavigationMode.kWaitAvoid: (navigation_pb2.kAccurate, navigation_pb2.kTimeout),
    }
    if action.mode not in modes:
        raise RefusedError(f"unknown navigation mode {action.mode}: use one of {list(modes)}")
    if action.wait_time > _LONGEST_WAIT:
        raise RefusedError(
            f"wait_time is {action.wait_time:g} s: give a number of at most {_LONGEST_WAIT}"
        )
    arrival, mode = modes[action.mode]
    setting = navigation_pb2.ModeSetting(
        type=arrival,
        mode=mode,
        wait_timeout=max(0, int(action.wait_time)),
        max_speed=usable_speed(action.max_speed),
    )
    if chassis.ownership.navigation is None:
        raise RefusedError(refusals.NO_NAVIGATION_FOR_MODE)
    chassis.ownership.navigation.change_mode(setting)


def _step_control(chassis: Chassis, action: action_pb2.StepControl) -> Job:
    """Return the job of a StepControl; raise RefusedError if a step is impossible."""
    if not action.steps:
        raise RefusedError(refusals.NO_STEPS)
    if len(action.steps) > _MAX_STEPS:
        raise RefusedError(
            f"StepControl has {len(action.steps)} steps, more than {_MAX_STEPS}: split it "
            "into several requests"
        )
    steps = [_step(chassis, step) for step in action.steps]
    return Steps(steps, avoid=action.avoid == 0)  # 0 is on, 1 off


def _step(chassis: Chassis, step: action_pb2.StepControl.Step) -> Shift | Turn:
    """Return one step, within the limits of the base; raise RefusedError if it is impossible."""
    speed = usable_speed(step.speed)
    if step.mode == _StepMode.kRotate:
        return Turn(step.value, min(speed or STEP_SPEED, chassis.base.max_turn_rate))
    directions = {
        _StepMode.kStraight: 0.0,
        _StepMode.kLateral: math.pi / 2,
        _StepMode.kDiagonalize: step.angle,
    }
    if step.mode not in directions:
        raise RefusedError(
            f"unknown step mode {step.mode}: 1 is straight, 2 rotate, 3 lateral, 4 diagonal"
        )
    if step.mode != _StepMode.kStraight and not chassis.omnidirectional:
        raise RefusedError(
            "a differential base cannot move sideways: use step modes 1 (straight) and 2 (rotate)"
        )
    fastest = min(speed or STEP_SPEED, chassis.base.max_speed)
    return Shift(directions[step.mode], step.value, fastest)


def _lift_control(chassis: Chassis, action: action_pb2.LiftControl) -> Job:
    if action.execute_mode == action_pb2.LiftControl.kUp:
        return MoveLift(chassis.jack, chassis.jack.travel)
    if action.execute_mode == action_pb2.LiftControl.kDown:
        return MoveLift(chassis.jack, 0.0)
    raise RefusedError(f"unknown lift mode {action.execute_mode}: 1 is up, 2 is down")


def _lift_control2(chassis: Chassis, action: action_pb2.LiftControl2) -> Job:
    return MoveLift(chassis.column, chassis.column.checked(action.height))


def _lift_control3(chassis: Chassis, action: action_pb2.LiftControl3) -> Job:
    column, mode = chassis.column, action.execute_mode
    speed = usable_speed(action.speed, _MIN_LIFT_SPEED)
    if mode == _Lift3.kQuery:
        return MoveLift(column, column.height)  # moves nothing, and reports the height
    if mode == _Lift3.kAbsolute:
        return MoveLift(column, column.checked(action.height), speed=speed)
    if mode == _Lift3.kRelative:
        height = column.checked(column.height + action.height)
        return MoveLift(column, height, speed=speed)
    if mode in (_Lift3.kCalibration, _Lift3.kTsetMode):  # no document says what the latter does
        return MoveLift(column, 0.0, speed=speed)
    raise RefusedError(
        f"unknown lift mode {mode}: 0 is query, 1 absolute, 2 relative, 3 calibration"
    )


def _charge_control(chassis: Chassis, action: action_pb2.ChargeControl) -> Job:
    """Return the job that charges at the charger where the robot stands, or leaves it."""
    if action.execute_mode == action_pb2.ChargeControl.kAuto:
        if chassis.charger is None:
            raise RefusedError("robot is not at a charger: start a charge task instead")
        return Charge()
    if action.execute_mode == action_pb2.ChargeControl.kExit:
        if chassis.charger is None:
            return Done("not at a charger")
        return leave_charger_job(chassis, chassis.charger)
    raise RefusedError(f"unknown charge mode {action.execute_mode}: 1 is automatic, 2 is exit")


def _move_base(chassis: Chassis, action: action_pb2.MoveBase) -> Job:
    """Return the job that drives through the poses to the target, by default the last pose."""
    way = poses(action.poses)
    target = pose(action.target_pose)
    # Some clients send an empty target together with the poses: it does not count.
    is_unused = target == Pose() and bool(way)
    if action.HasField("target_pose") and not is_unused:
        if way and way[-1] == target:
            way.pop()
    elif way:
        target = way.pop()
    else:
        raise RefusedError("MoveBase has no target: give target_pose or poses")
    one_by_one = action.execution_mode == action_pb2.MoveBase.kOneByOne
    return Navigate(target, way, one_by_one=one_by_one)


_JOBS: dict[str, Callable[[Chassis, Any], Job]] = {
    "step_control": _step_control,
    "lift_control": _lift_control,
    "lift_control2": _lift_control2,
    "lift_control3": _lift_control3,
    "charge_control": _charge_control,
    "move_base": _move_base,
}
"""Functions that make the job of an action, by its field in CallAction; `nav_mode` has no job."""


@query(pack.PlanNavPath)
def _plan_nav_path(chassis: Chassis, request: pack.PlanNavPath) -> Message:
    """Return the path that a navigation would take, without driving; by default from the robot."""
    if not request.HasField("end"):
        raise RefusedError("PlanNavPath has no end: give the pose to plan a path to")
    if request.tolerance < 0.0:
        raise RefusedError(f"tolerance {request.tolerance:g} is negative: use 0 for any detour")
    start, end = pose(request.start), pose(request.end)
    if not request.HasField("start"):
        chassis.readiness.require_located()
        start = chassis.pose
    for each in (start, end):
        chassis.require_room(each)
    try:
        route = plan_route(chassis, start, [end])
    except NoRouteError as error:
        raise RefusedError(str(error)) from None
    detour = route.length - start.distance(end.point)
    if request.tolerance and detour > request.tolerance:
        raise RefusedError(
            f"the path has a detour of {detour:.2f} m, more than the tolerance of "
            f"{request.tolerance:g} m: raise it"
        )
    path = navigation_pb2.Path(poses=map(pose2d, route.poses))
    return robot_pb2.NavPath(robot_id=chassis.robot_id, path=path)
