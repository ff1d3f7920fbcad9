"""Handler of `woosh.ros.CallAction`, which starts, pauses, resumes and cancels actions."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from woosh_robot_agent.pb.ros import action_pb2, ros_pack_pb2
from woosh_robot_agent.pb.util import navigation_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.charging import Charge, EndCharge
from woosh_robot_agent.simulator.behaviour.jobs import Job
from woosh_robot_agent.simulator.behaviour.lifting import MoveLift
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.behaviour.steps import Shift, Steps, Turn
from woosh_robot_agent.simulator.body.base import MAX_SPEED, MAX_TURN_RATE
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import (
    Handlers,
    Result,
    pose,
    poses,
    usable_speed,
)
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.world.geometry import Pose

_MAX_STEPS = 1000
"""Maximum number of steps of an action."""

_STEP_SPEED = 0.5
"""Default speed of steps, in m/s or rad/s."""

_MIN_SPEED = 0.01
"""Minimum speed of steps and navigation, in m/s or rad/s."""

_MIN_LIFT_SPEED = 0.001
"""Minimum speed of the lift, in m/s."""

_StepMode = action_pb2.StepControl.Step
_Lift3 = action_pb2.LiftControl3


def _call_action(chassis: Chassis, request: ros_pack_pb2.CallAction) -> Result:
    which = request.WhichOneof("action")
    if which is None:
        raise RefusedError(refusals.NO_ACTION)
    command: Any = getattr(request, which)
    if which == "nav_mode":
        return _navigation_mode(chassis, command)
    if which not in _JOBS:
        raise RefusedError(refusals.UNKNOWN_ACTION, action=command.type, actions=", ".join(_JOBS))
    name = command.DESCRIPTOR.full_name
    if command.action == action_pb2.kExecute:
        chassis.readiness.require_ready()
        chassis.ownership.start_action(name, _JOBS[which](chassis, command))
    elif command.action == action_pb2.kCancel:
        chassis.actions.cancel(name)
    elif command.action == action_pb2.kPause:
        chassis.actions.pause(name)
    elif command.action == action_pb2.kResume:
        chassis.readiness.require_ready()
        chassis.ownership.resume_action(name)
    else:
        raise RefusedError(refusals.UNKNOWN_CONTROL, control=command.action)
    return None


def _navigation_mode(chassis: Chassis, command: action_pb2.NavigationMode) -> Result:
    modes = {
        action_pb2.NavigationMode.kVagueAvoid: (navigation_pb2.kVague, navigation_pb2.kAvoid),
        action_pb2.NavigationMode.kAccurateAvoid: (navigation_pb2.kAccurate, navigation_pb2.kAvoid),
        action_pb2.NavigationMode.kWaitNav: (navigation_pb2.kAccurate, navigation_pb2.kNavWait),
        action_pb2.NavigationMode.kWaitAvoid: (navigation_pb2.kAccurate, navigation_pb2.kTimeout),
    }
    if command.mode not in modes:
        raise RefusedError(refusals.UNKNOWN_NAVIGATION_MODE, mode=command.mode, modes=list(modes))
    arrival, mode = modes[command.mode]
    setting = navigation_pb2.ModeSetting(
        type=arrival,
        mode=mode,
        wait_timeout=max(0, int(command.wait_time)),
        max_speed=usable_speed(command.max_speed, _MIN_SPEED),
    )
    if chassis.ownership.navigation is None:
        raise RefusedError(refusals.NAVIGATION_MODE_UNUSED)
    chassis.ownership.navigation.change_mode(setting)
    return None


def _step_control(chassis: Chassis, command: action_pb2.StepControl) -> Job:
    if not command.steps:
        raise RefusedError(refusals.NO_STEPS)
    if len(command.steps) > _MAX_STEPS:
        raise RefusedError(refusals.TOO_MANY_STEPS, count=len(command.steps), limit=_MAX_STEPS)
    steps = [_step(chassis, step) for step in command.steps]
    return Steps(steps, avoid=command.avoid == 0)


def _step(chassis: Chassis, step: action_pb2.StepControl.Step) -> Shift | Turn:
    speed = usable_speed(step.speed, _MIN_SPEED)
    if step.mode == _StepMode.kRotate:
        return Turn(step.value, min(speed or _STEP_SPEED, MAX_TURN_RATE))
    directions = {
        _StepMode.kStraight: 0.0,
        _StepMode.kLateral: math.pi / 2,
        _StepMode.kDiagonalize: step.angle,
    }
    if step.mode not in directions:
        raise RefusedError(refusals.UNKNOWN_STEP_MODE, mode=step.mode)
    if step.mode != _StepMode.kStraight and not chassis.omnidirectional:
        raise RefusedError(refusals.STEP_SIDEWAYS)
    return Shift(directions[step.mode], step.value, min(speed or _STEP_SPEED, MAX_SPEED))


def _lift_control(chassis: Chassis, command: action_pb2.LiftControl) -> Job:
    if command.execute_mode == action_pb2.LiftControl.kUp:
        return MoveLift(chassis.jack, chassis.jack.travel)
    if command.execute_mode == action_pb2.LiftControl.kDown:
        return MoveLift(chassis.jack, 0.0)
    raise RefusedError(refusals.UNKNOWN_LIFT_MODE, mode=command.execute_mode)


def _lift_control2(chassis: Chassis, command: action_pb2.LiftControl2) -> Job:
    return MoveLift(chassis.column, chassis.column.checked(command.height))


def _lift_control3(chassis: Chassis, command: action_pb2.LiftControl3) -> Job:
    column, mode = chassis.column, command.execute_mode
    speed = usable_speed(command.speed, _MIN_LIFT_SPEED)
    if mode == _Lift3.kQuery:
        return MoveLift(column, column.height)
    if mode == _Lift3.kAbsolute:
        return MoveLift(column, column.checked(command.height), speed=speed)
    if mode == _Lift3.kRelative:
        height = column.checked(column.height + command.height)
        return MoveLift(column, height, speed=speed)
    if mode == _Lift3.kCalibration:
        return MoveLift(column, 0.0, speed=speed)
    if mode == _Lift3.kTsetMode:
        return MoveLift(column, 0.0, column.travel, 0.0, speed=speed)
    raise RefusedError(refusals.UNKNOWN_LIFT3_MODE, mode=mode)


def _charge_control(chassis: Chassis, command: action_pb2.ChargeControl) -> Job:
    if command.execute_mode == action_pb2.ChargeControl.kAuto:
        if not chassis.at_charger():
            raise RefusedError(refusals.NOT_AT_CHARGER)
        return Charge()
    if command.execute_mode == action_pb2.ChargeControl.kExit:
        return EndCharge()
    raise RefusedError(refusals.UNKNOWN_CHARGE_MODE, mode=command.execute_mode)


def _move_base(chassis: Chassis, command: action_pb2.MoveBase) -> Job:
    way = poses(command.poses)
    target = pose(command.target_pose)
    # Some clients send an empty target together with the poses.
    if command.HasField("target_pose") and (target != Pose() or not way):
        if way and way[-1] == target:
            way.pop()
    elif way:
        target = way.pop()
    else:
        raise RefusedError(refusals.NO_GOAL)
    one_by_one = command.execution_mode == action_pb2.MoveBase.kOneByOne
    return Navigate(target, way, one_by_one=one_by_one)


_JOBS: dict[str, Callable[[Chassis, Any], Job]] = {
    "step_control": _step_control,
    "lift_control": _lift_control,
    "lift_control2": _lift_control2,
    "lift_control3": _lift_control3,
    "charge_control": _charge_control,
    "move_base": _move_base,
}
"""Functions that make the job of an action, by the name of its field in CallAction."""

HANDLERS: Handlers = {ros_pack_pb2.CallAction: _call_action}
