"""Handlers of requests about localisation, modes, flags, speech and Wi-Fi."""

from __future__ import annotations

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol import reports
from woosh_robot_agent.simulator.protocol.handlers import Handlers, Result, pose
from woosh_robot_agent.simulator.refusals import RefusedError

_MAX_SPEECH = 1000
"""Number of characters of a spoken text that are kept."""


def _init_robot(chassis: Chassis, request: pack.InitRobot) -> Result:
    if chassis.profile.refusals.while_busy and chassis.tasks.active:
        task = chassis.tasks.proc.robot_task_id
        raise RefusedError(refusals.INIT_DURING_TASK, task=task)
    chassis.mapping.require_none(refusals.INIT_WHILE_MAPPING)
    # Clients may send both, with an empty pose: the record takes precedence.
    where = chassis.base.pose if request.is_record else pose(request.pose)
    chassis.localise(where)
    reason = "robot was initialised"
    chassis.ownership.end_driving(reason)
    chassis.base.halt()
    if chassis.tasks.active:
        chassis.tasks.cancel(reason)
    # The answer comes when it is done.
    chassis.answer_delay = chassis.initialise()
    return None


def _set_robot_pose(chassis: Chassis, request: pack.SetRobotPose) -> Result:
    if not (chassis.readiness.initialised or chassis.mapping.active):
        raise RefusedError(refusals.NOT_INITIALISED)
    if chassis.readiness.located:
        chassis.mapping.require_none(refusals.POSE_WHILE_MAPPING)
    chassis.localise(pose(request.pose))
    return None


def _set_occupancy(chassis: Chassis, request: pack.SetOccupancy) -> Result:
    chassis.occupied = request.occupy
    return None


def _set_mute_call(chassis: Chassis, request: pack.SetMuteCall) -> Result:
    chassis.call_muted = request.mute
    return None


def _set_program_mute(chassis: Chassis, request: pack.SetProgramMute) -> Result:
    chassis.program_muted = request.mute
    return None


def _switch_control_mode(chassis: Chassis, request: pack.SwitchControlMode) -> Result:
    known = (util_robot_pb2.kAuto, util_robot_pb2.kManual, util_robot_pb2.kMaintain)
    if request.mode not in known:
        raise RefusedError(refusals.UNKNOWN_CONTROL_MODE, mode=request.mode)
    if chassis.readiness.key_manual and request.mode != util_robot_pb2.kManual:
        raise RefusedError(refusals.KEY_AT_MANUAL)
    chassis.readiness.ctrl = request.mode
    return reports.mode(chassis)


def _switch_work_mode(chassis: Chassis, request: pack.SwitchWorkMode) -> Result:
    known = (
        util_robot_pb2.kDeployMode,
        util_robot_pb2.kTaskMode,
        util_robot_pb2.kScheduleMode,
    )
    if request.mode not in known:
        raise RefusedError(refusals.UNKNOWN_WORK_MODE, mode=request.mode)
    if request.mode != chassis.readiness.work:
        chassis.mapping.require_none(refusals.WORK_MODE_WHILE_MAPPING)
        chassis.deployment.end_session()
    chassis.readiness.work = request.mode
    return reports.mode(chassis)


def _switch_foot_print(chassis: Chassis, request: pack.SwitchFootPrint) -> Result:
    if request.type not in chassis.footprints:
        raise RefusedError(
            refusals.UNKNOWN_FOOTPRINT, footprint=request.type, footprints=list(chassis.footprints)
        )
    chassis.footprint = request.type
    if chassis.ownership.navigation:
        chassis.ownership.navigation.replan()
    return pack.SwitchFootPrint(type=chassis.footprint)


def _speak(chassis: Chassis, request: pack.Speak) -> Result:
    chassis.spoken.append(request.text[:_MAX_SPEECH])
    return None


def _wifi(chassis: Chassis, request: pack.RobotWiFi) -> Result:
    wifi, order = chassis.wifi, request.order
    answer = pack.RobotWiFi(order=order)
    if order == pack.RobotWiFi.kWiFiList:
        answer.content = wifi.scan()
        text = answer.content.decode()
        feedback = ros_pack_pb2.Feedback(state=ros_pack_pb2.kRosWiFiJson, msg=text)
        chassis.emit(ros_pack_pb2.Feedbacks(fbs=[feedback]))
    elif order == pack.RobotWiFi.kAdd:
        wifi.add(request.content, connect=request.is_connect_now)
    elif order == pack.RobotWiFi.kReconnect:
        wifi.reconnect(request.content)
    elif order == pack.RobotWiFi.kForget:
        wifi.forget(request.content)
    elif order == pack.RobotWiFi.kHotspot:
        wifi.switch_hotspot(on=request.enable)
        answer.enable = request.enable
    else:
        raise RefusedError(refusals.UNKNOWN_WIFI_ORDER, order=order)
    return answer


HANDLERS: Handlers = {
    pack.InitRobot: _init_robot,
    pack.SetRobotPose: _set_robot_pose,
    pack.SetOccupancy: _set_occupancy,
    pack.SetMuteCall: _set_mute_call,
    pack.SetProgramMute: _set_program_mute,
    pack.SwitchControlMode: _switch_control_mode,
    pack.SwitchWorkMode: _switch_work_mode,
    pack.SwitchFootPrint: _switch_foot_print,
    pack.Speak: _speak,
    pack.RobotWiFi: _wifi,
}
