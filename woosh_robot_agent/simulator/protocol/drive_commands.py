"""Handlers of remote control and following."""

from __future__ import annotations

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator.body.base import STANDSTILL, Velocity
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.errors import RefusedError
from woosh_robot_agent.simulator.protocol.handlers import Handlers, Result


def _twist(chassis: Chassis, request: pack.Twist) -> Result:
    velocity = Velocity(request.linear, request.linear_y, request.angular)
    if velocity == STANDSTILL:
        driver = chassis.ownership.driver
        chassis.ownership.stop_wheels("stopped by a velocity of zero")
        return f"stopped: {driver} is paused, continue or cancel it" if driver else None
    if chassis.readiness.emergency_stop:
        raise RefusedError("emergency stop is pressed: release it first")
    if chassis.readiness.battery_empty:
        raise RefusedError("battery is empty: charge first")
    if chassis.readiness.control == util_robot_pb2.kMaintain:
        raise RefusedError("robot is in maintenance mode: switch to automatic or manual first")
    if velocity.left and not chassis.omnidirectional:
        raise RefusedError("a differential base cannot move sideways: linear_y must be 0")
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
