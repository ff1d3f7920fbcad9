"""Handlers of requests that change the settings. Each answer contains the new setting."""

from __future__ import annotations

from woosh_robot_agent.pb.robot import robot_setting_pb2 as setting_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import Handlers, Result, copy_of
from woosh_robot_agent.simulator.refusals import RefusedError

_MAX_NAME = 100
"""Maximum length of the robot's name."""

_MAX_HOST = 253
"""Maximum length of a host name."""


def _check_length(field: str, text: str, most: int) -> None:
    if len(text) > most:
        raise RefusedError(refusals.TEXT_TOO_LONG, field=field, limit=most)


def _identity(chassis: Chassis, request: setting_pb2.Identity) -> Result:
    _check_length("name", request.name, _MAX_NAME)
    chassis.setting.identity.name = request.name
    return copy_of(chassis.setting.identity)


def _server(chassis: Chassis, request: setting_pb2.Server) -> Result:
    if request.port > 65535:
        raise RefusedError(refusals.PORT_OUT_OF_RANGE, port=request.port)
    _check_length("ip", request.ip, _MAX_HOST)
    chassis.setting.server.ip = request.ip
    chassis.setting.server.port = request.port
    return copy_of(chassis.setting.server)


def _auto_charge(chassis: Chassis, request: setting_pb2.AutoCharge) -> Result:
    chassis.setting.allow.auto_charge = request.allow
    return setting_pb2.AutoCharge(allow=request.allow)


def _auto_park(chassis: Chassis, request: setting_pb2.AutoPark) -> Result:
    chassis.setting.allow.auto_park = request.allow
    return setting_pb2.AutoPark(allow=request.allow)


def _goods_check(chassis: Chassis, request: setting_pb2.GoodsCheck) -> Result:
    chassis.setting.allow.goods_check = request.allow
    return setting_pb2.GoodsCheck(allow=request.allow)


def _power(chassis: Chassis, request: setting_pb2.Power) -> Result:
    levels = [request.alarm, request.low, request.idle, request.full]
    if levels != sorted(levels) or request.full > 100:
        raise RefusedError(refusals.POWER_LEVELS_INVALID, levels=levels)
    power = chassis.setting.power
    power.alarm, power.low, power.idle, power.full = levels
    return copy_of(power)


def _sound(chassis: Chassis, request: setting_pb2.Sound) -> Result:
    if request.volume > 100:
        raise RefusedError(refusals.VOLUME_OUT_OF_RANGE, volume=request.volume)
    chassis.setting.sound.mute = request.mute
    chassis.setting.sound.volume = request.volume
    return copy_of(chassis.setting.sound)


HANDLERS: Handlers = {
    setting_pb2.Identity: _identity,
    setting_pb2.Server: _server,
    setting_pb2.AutoCharge: _auto_charge,
    setting_pb2.AutoPark: _auto_park,
    setting_pb2.GoodsCheck: _goods_check,
    setting_pb2.Power: _power,
    setting_pb2.Sound: _sound,
}
