"""Handlers of remote control and following."""

from __future__ import annotations

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.body.base import STANDSTILL, Velocity
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import Handlers, Result
from woosh_robot_agent.simulator.refusals import RefusedError


def _twist(chassis: Chassis, request: pack.Twist) -> Result:
    velocity = Velocity(request.linear, request.linear_y, request.angular)
    if velocity == STANDSTILL:
        driver = chassis.ownership.driver
        chassis.ownership.stop_wheels("stopped by a velocity of zero")
        return f"stopped: {driver} is paused, continue or cancel it" if driver else None
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
        raise RefusedError(refusals.TWIST_SIDEWAYS)
    chassis.ownership.drive(velocity)
    return None


def _follow(chassis: Chassis, request: pack.Follow) -> Result:
    if request.type:
        chassis.readiness.require_ready()
        chassis.ownership.follow()
    else:
        chassis.follower.stop()
    return None


HANDLERS: Handlers = {pack.Twist: _twist, pack.Follow: _follow}
